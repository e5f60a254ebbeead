/* formula, exported by Kennfeld */

/* A compiler that fuses sums with products, such as GCC without -std=c99, needs -ffp-contract=off to compute
   the same bits as Kennfeld. Never use -ffast-math: NaN has to stay NaN. */

#include "line.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

const line_parameters line_defaults = {
    1.0 /* k */
};

void line_init(line_states *s)
{
    (void)memset(s, 0, sizeof(*s));
}

void line_step(const line_parameters *p, line_states *s, const line_inputs *u, line_outputs *y)
{
    (void)s;
    const double v2 = 2.0 * u->x;
    const double v3 = p->k;
    const double v4 = v2 + v3; /* y, formula line 1 */

    y->y = v4;
}
