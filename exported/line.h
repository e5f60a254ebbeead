/* formula, exported by Kennfeld */

#ifndef LINE_H
#define LINE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Calibration values */
typedef struct {
    double k;
} line_parameters;

/* Memory; see the source */
typedef struct {
    uint8_t none;
} line_states;

/* Inputs of a step */
typedef struct {
    double x;
} line_inputs;

/* Outputs of a step */
typedef struct {
    double y;
} line_outputs;

/* The calibration that was exported */
extern const line_parameters line_defaults;

/* Forgets the past: the next step is the first one */
void line_init(line_states *s);

/* Computes the outputs of one sample, and remembers what the next one needs */
void line_step(const line_parameters *p, line_states *s, const line_inputs *u, line_outputs *y);

#ifdef __cplusplus
}
#endif

#endif
