/* An FMU for model exchange without continuous states, of FMI 2.0 (-DFMI=2) or 3.0 (-DFMI=3).
 *
 *   y = gain (100 mode + 10 gear + on) + step,  same = gear,  lit = on,  chosen = mode;  FMI 3.0: small = narrow + level
 *
 * With -DTIME_EVENT step is 1 from time 1 on, a condition that is evaluated in event mode only and announced; with
 * -DCOUNTER it counts such events. Otherwise it is 0.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { GAIN = 1, GEAR, ON, MODE, Y, SAME, LIT, CHOSEN, NARROW, LEVEL, SMALL };
typedef struct {
    double time, gain;
    int gear, on, mode, step, count;
    float narrow;
    uint8_t level;
} Signals;

static Signals *create(const char *token) {
    Signals *m = strcmp(token, "{signals}") == 0 ? calloc(1, sizeof(Signals)) : NULL;
    if (m) m->gain = m->mode = 1;
    return m;
}

static int update(Signals *m, double *next) {
#ifdef COUNTER
    m->step = m->count += m->time >= m->count + 1;
    *next = m->count + 1;
    return 1;
#elif defined TIME_EVENT
    m->step = m->time >= 1.0;
    *next = 1.0;
    return m->time < 1.0;
#else
    (void)next;
    return 0;
#endif
}

static double real(Signals *m, unsigned r) {
    return r == Y ? m->gain * (100 * m->mode + 10 * m->gear + m->on) + m->step : m->gain;
}

#define M ((Signals *)c)
#define EACH for (size_t i = 0; i < n; i++)
#if FMI == 2
#define F(name) fmi2##name
typedef struct { int needed, terminate, nominals, values, timed; double time; } EventInfo;
void *fmi2Instantiate(const char *n, int type, const char *guid, const char *r, const void *c, int v, int l) { return create(guid); }
int fmi2SetupExperiment(void *c, int d, double t, double s, int e, double stop) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2NewDiscreteStates(void *c, EventInfo *info) {
    EventInfo result = {0};
    result.timed = update(c, &result.time);
    *info = result;
    return 0;
}
int fmi2GetDerivatives(void *c, double *d, size_t n) { return 0; }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) { EACH M->gain = v[i]; return 0; }
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) { EACH v[i] = real(c, r[i]); return 0; }
int fmi2SetInteger(void *c, const unsigned *r, size_t n, const int *v) { EACH *(r[i] == GEAR ? &M->gear : &M->mode) = v[i]; return 0; }
int fmi2GetInteger(void *c, const unsigned *r, size_t n, int *v) { EACH v[i] = r[i] == SAME ? M->gear : M->mode; return 0; }
int fmi2SetBoolean(void *c, const unsigned *r, size_t n, const int *v) { EACH M->on = v[i]; return 0; }
int fmi2GetBoolean(void *c, const unsigned *r, size_t n, int *v) { EACH v[i] = M->on; return 0; }
#else
#define F(name) fmi3##name
void *fmi3InstantiateModelExchange(const char *n, const char *token, const char *r, bool v, bool l, void *e, void *log) { return create(token); }
int fmi3EnterInitializationMode(void *c, bool d, double t, double s, bool e, double stop) { return 0; }
int fmi3UpdateDiscreteStates(void *c, bool *needed, bool *end, bool *nominals, bool *values, bool *timed, double *t) {
    *needed = *end = *nominals = *values = false;
    *timed = update(c, t);
    return 0;
}
int fmi3GetContinuousStateDerivatives(void *c, double *d, size_t n) { return 0; }
#define ARGUMENTS(type) (void *c, const unsigned *r, size_t n, type *v, size_t nv)
int fmi3SetFloat64 ARGUMENTS(const double) { EACH M->gain = v[i]; return 0; }
int fmi3GetFloat64 ARGUMENTS(double) { EACH v[i] = real(c, r[i]); return 0; }
int fmi3SetInt32 ARGUMENTS(const int32_t) { EACH M->gear = v[i]; return 0; }
int fmi3GetInt32 ARGUMENTS(int32_t) { EACH v[i] = M->gear; return 0; }
int fmi3SetInt64 ARGUMENTS(const int64_t) { EACH M->mode = (int)v[i]; return 0; }
int fmi3GetInt64 ARGUMENTS(int64_t) { EACH v[i] = M->mode; return 0; }
int fmi3SetBoolean ARGUMENTS(const bool) { EACH M->on = v[i]; return 0; }
int fmi3GetBoolean ARGUMENTS(bool) { EACH v[i] = M->on; return 0; }
int fmi3SetFloat32 ARGUMENTS(const float) { EACH M->narrow = v[i]; return 0; }
int fmi3GetFloat32 ARGUMENTS(float) { EACH v[i] = M->narrow + M->level; return 0; }
int fmi3SetUInt8 ARGUMENTS(const uint8_t) { EACH M->level = v[i]; return 0; }
#endif

int F(Reset)(void *c) { memset(c, 0, sizeof *M); M->gain = M->mode = 1; return 0; }
int F(ExitInitializationMode)(void *c) { return 0; }
int F(EnterEventMode)(void *c) { return 0; }
int F(EnterContinuousTimeMode)(void *c) { return 0; }
int F(SetTime)(void *c, double t) { M->time = t; return 0; }
int F(SetContinuousStates)(void *c, const double *x, size_t n) { return 0; }
int F(GetContinuousStates)(void *c, double *x, size_t n) { return 0; }
int F(Terminate)(void *c) { return 0; }
void F(FreeInstance)(void *c) { free(c); }
