/* A tank, as an FMU for co-simulation of FMI 2.0 (-DFMI=2) or 3.0 (-DFMI=3).
 *
 * A step of length h from t:  x += h (if open: flow * gain, else 0) - h x / tau,  steps += 1
 * At the start:               x = level + flow,  steps = mode
 * Outputs:                    y = x + sum of (i + 1) table[i],  steps (integer),  high (boolean, x > 1)
 *
 * `gain` is tunable, `tau`, `level` and `table[1..3]` are fixed. From t = `at` on, a step returns the status `fault`; 6 is
 * an early return (FMI 3.0), 7 the end of the simulation. tau <= 0 is an error at initialization. With -DSINGLE there is
 * one instance at a time, with -DNO_RESET fmi2Reset fails, with -DLAZY_RESET it keeps the state x for the next start, and
 * with -DEVEN steps must have the length of the first one. With -DDEMANDING initialization and steps return errors unless
 * the process is as the standards and compilers demand, see `complaint`. -DIN_STEP and -DIN_FREE hold statements that run
 * first there.
 */
#include <fenv.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { TIME, FLOW, MODE, OPEN, Y, STEPS, HIGH, GAIN, TAU, LEVEL, FAULT, AT, TABLE };
typedef void (*Log)(void);
typedef struct {
    double time, flow, x, gain, tau, level, fault, at, table[3], step;
    int mode, open, steps, initialized, ended;
    void *environment;
    Log log;
    const void *callbacks;
    char place[1000];
} Tank;

static int living;

static void start(Tank *m) {
    Tank fresh = {.gain = 1.0, .tau = 2.0, .at = 1e30, .table = {0, 0, 0}, .open = 1};
    fresh.environment = m->environment;
    fresh.log = m->log;
    fresh.callbacks = m->callbacks;
    strcpy(fresh.place, m->place);
#ifdef LAZY_RESET
    fresh.x = m->x;
#endif
    *m = fresh;
}

static Tank *create(void *environment, Log log, const void *callbacks, const char *place) {
#ifdef SINGLE
    if (living) return NULL;
#endif
    Tank *m = calloc(1, sizeof *m);
    m->environment = environment;
    m->log = log;
    m->callbacks = callbacks;
    strncpy(m->place, place, sizeof m->place - 1);
    living++;
    start(m);
    m->x = 0.0;
    return m;
}

static void say(Tank *m, int status, const char *text) {
#if FMI == 2
    void (*log)(void *, const char *, int, const char *, const char *, ...) = (void *)m->log;
    log(m->environment, "tank", status, "error", "%s by %.1f l at %d bar, %d %d %d %g", text, 2.5, 7, 1, 2, 3, m->fault);
#else
    ((void (*)(void *, int, const char *, const char *))m->log)(m->environment, status, "e", text);
#endif
}

static double *real(Tank *m, unsigned reference) {
    switch (reference) {
    case FLOW: return &m->flow;
    case GAIN: return &m->gain;
    case TAU: return &m->tau;
    case LEVEL: return &m->level;
    case FAULT: return &m->fault;
    case AT: return &m->at;
    default: return reference >= TABLE && reference < TABLE + 3 ? &m->table[reference - TABLE] : NULL;
    }
}

static int set(Tank *m, unsigned reference, double value) {
    double *place = real(m, reference);
    if (!place || (m->initialized && reference >= TAU)) return 3;
    *place = value;
    return 0;
}

static int get(Tank *m, unsigned reference, double *value) {
    if (reference != Y) return 3;
    *value = m->x + m->table[0] + 2 * m->table[1] + 3 * m->table[2];
    return 0;
}

#if FMI == 2
typedef struct { void *log, *allocate, *release, *finished, *environment; } Callbacks;
#endif
#ifdef DEMANDING
static int out_of_order;  /* a reset or an end without a termination before */

static int deep(int depth) {
    volatile unsigned char frame[4096];
    frame[0] = (unsigned char)depth;
    return depth ? deep(depth - 1) + frame[0] : 0;
}

static const char *complaint(Tank *m) {
    struct stat status;
    if (out_of_order) return "an instance was reset or freed before it was terminated";
    /* code that stores vectors in its frame crashes otherwise */
    if ((size_t)__builtin_frame_address(0) % 16) return "the stack is not aligned";
    if (fegetround() != FE_TONEAREST) return "numbers are not rounded to nearest";
    volatile double least = 2.2250738585072014e-308;
    if (least / 2 == 0.0) return "small numbers are flushed to zero";
    if (deep(750) < 0) return "3 MB of stack are lost";
    const char *place = m->place;
#if FMI == 2
    /* callbacks and their structure are used as long as an instance lives */
    const Callbacks *callbacks = m->callbacks;
    void *(*allocate)(size_t, size_t) = (void *(*)(size_t, size_t))callbacks->allocate;
    void (*release)(void *) = (void (*)(void *))callbacks->release;
    for (int i = 0; i < 2; i++) {
        unsigned char *memory = allocate(1000, 8);
        for (int k = 0; k < 8000; k++)
            if (memory[k]) return "memory is not set to 0";
        memset(memory, 255, 8000);
        release(memory);
    }
    if (strncmp(place, "file:///", 8) || place[strlen(place) - 1] == '/') return "resources are not a URI";
    place += 7;
#else
    if (place[0] != '/' || place[strlen(place) - 1] != '/') return "resources are not a path with a separator";
#endif
    return stat(place, &status) || !S_ISDIR(status.st_mode) ? "there is no folder of resources" : NULL;
}
#endif

static int initialize(Tank *m) {
#ifdef DEMANDING
    const char *text = complaint(m);
    if (text) {
        say(m, 3, text);
        return 3;
    }
#endif
    if (m->tau <= 0.0) {
        say(m, 3, "tau must be positive");
        return 3;
    }
    m->initialized = 1;
    m->x += m->level + m->flow;
    m->steps = m->mode;
    return 0;
}

#ifndef IN_STEP
#define IN_STEP
#endif
#ifndef IN_FREE
#define IN_FREE
#endif

static int step(Tank *m, double t, double h) {
    IN_STEP;
#ifdef DEMANDING
    const char *text = complaint(m);
    if (text) {
        say(m, 3, text);
        return 3;
    }
#endif
    if (fabs(t - m->time) > 1e-9 || h <= 0.0) return 3;
#if FMI == 2
    m->ended = t + h >= m->at - 1e-9 && m->fault == 7;
#endif
    if (t + h >= m->at - 1e-9 && m->fault >= 2 && m->fault < 6) {
        say(m, (int)m->fault, "the tank leaks");
        return (int)m->fault;
    }
#ifdef EVEN
    if (m->steps > m->mode && h != m->step) return 3;
    m->step = h;
#endif
    m->x += h * (m->open ? m->flow * m->gain : 0.0) - h * m->x / m->tau;
    m->steps++;
    m->time = t + h;
    return m->ended ? 2 : 0;
}

#define EACH for (size_t i = 0; i < n; i++)
#if FMI == 2
#define F(name) fmi2##name
void *fmi2Instantiate(const char *n, int type, const char *guid, const char *r, const void *c, int v, int l) {
    const Callbacks *callbacks = c;
    return type == 1 && !strcmp(guid, "{tank}") ? create(callbacks->environment, (Log)callbacks->log, c, r) : NULL;
}
int fmi2SetupExperiment(void *c, int d, double t, double s, int e, double stop) { ((Tank *)c)->time = s; return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) {
    int s = 0;
    EACH s |= set(c, r[i], v[i]);
    return s;
}
int fmi2SetInteger(void *c, const unsigned *r, size_t n, const int *v) { ((Tank *)c)->mode = v[0]; return r[0] == MODE ? 0 : 3; }
int fmi2SetBoolean(void *c, const unsigned *r, size_t n, const int *v) { ((Tank *)c)->open = v[0]; return r[0] == OPEN ? 0 : 3; }
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) {
    int s = 0;
    EACH s |= get(c, r[i], v + i);
    return s;
}
int fmi2GetInteger(void *c, const unsigned *r, size_t n, int *v) { v[0] = ((Tank *)c)->steps; return r[0] == STEPS ? 0 : 3; }
int fmi2GetBoolean(void *c, const unsigned *r, size_t n, int *v) { v[0] = ((Tank *)c)->x > 1.0; return r[0] == HIGH ? 0 : 3; }
int fmi2DoStep(void *c, double t, double h, int keep) { return step(c, t, h); }
int fmi2GetBooleanStatus(void *c, int kind, int *value) { *value = kind == 3 && ((Tank *)c)->ended; return 0; }
int fmi2GetRealStatus(void *c, int kind, double *value) { *value = ((Tank *)c)->time; return kind == 2 ? 0 : 2; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const *names) { return 0; }
#else
#define F(name) fmi3##name
void *fmi3InstantiateCoSimulation(const char *n, const char *token, const char *r, bool v, bool l, bool events, bool early,
                                  const unsigned *required, size_t count, void *environment, Log log, void *update) {
    return !events && !early && !strcmp(token, "{tank}") ? create(environment, log, NULL, r) : NULL;
}
int fmi3EnterInitializationMode(void *c, bool d, double t, double s, bool e, double stop) { ((Tank *)c)->time = s; return 0; }
int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *v, size_t values) {
    int s = 0;
    for (size_t i = 0, at = 0; i < n; i++)
        for (unsigned k = 0; k < (r[i] == TABLE ? 3u : 1u); k++) s |= set(c, r[i] + k, v[at++]);
    return s;
}
int fmi3SetInt32(void *c, const unsigned *r, size_t n, const int *v, size_t k) { ((Tank *)c)->mode = v[0]; return r[0] == MODE ? 0 : 3; }
int fmi3SetBoolean(void *c, const unsigned *r, size_t n, const bool *v, size_t k) { ((Tank *)c)->open = v[0]; return r[0] == OPEN ? 0 : 3; }
int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *v, size_t k) {
    int s = 0;
    EACH s |= get(c, r[i], v + i);
    return s;
}
int fmi3GetInt32(void *c, const unsigned *r, size_t n, int *v, size_t k) { v[0] = ((Tank *)c)->steps; return r[0] == STEPS ? 0 : 3; }
int fmi3GetBoolean(void *c, const unsigned *r, size_t n, bool *v, size_t k) { v[0] = ((Tank *)c)->x > 1.0; return r[0] == HIGH ? 0 : 3; }
int fmi3DoStep(void *c, double t, double h, bool keep, bool *event, bool *end, bool *early, double *reached) {
    Tank *m = c;
    int late = t + h >= m->at - 1e-9;
    *event = false;
    *early = late && m->fault == 6;
    *end = late && m->fault == 7;
    *reached = t + h;
    return step(c, t, h);
}
int fmi3SetDebugLogging(void *c, bool on, size_t n, const char *const *names) { return 0; }
#endif

int F(ExitInitializationMode)(void *c) { return initialize(c); }
int F(Reset)(void *c) {
#ifdef NO_RESET
    return 3;
#else
#ifdef DEMANDING
    out_of_order |= ((Tank *)c)->initialized;
#endif
    start(c);
    return 0;
#endif
}
int F(Terminate)(void *c) { ((Tank *)c)->initialized = 0; return 0; }
void F(FreeInstance)(void *c) {
    IN_FREE;
#ifdef DEMANDING
    out_of_order |= ((Tank *)c)->initialized;
#endif
    living--;
    free(c);
}

/* functions that tools look for, and that nobody calls here */
#define STUB(name) int F(name)(void) { return 0; }
#if FMI == 2
    STUB(GetTypesPlatform) STUB(GetVersion) STUB(GetString) STUB(SetString) STUB(GetFMUstate) STUB(SetFMUstate)
    STUB(FreeFMUstate) STUB(SerializedFMUstateSize) STUB(SerializeFMUstate) STUB(DeSerializeFMUstate)
    STUB(GetDirectionalDerivative) STUB(SetRealInputDerivatives) STUB(GetRealOutputDerivatives) STUB(CancelStep)
    STUB(GetStatus) STUB(GetIntegerStatus) STUB(GetStringStatus)
#else
    STUB(GetVersion) STUB(InstantiateModelExchange) STUB(InstantiateScheduledExecution) STUB(GetFloat32) STUB(GetInt8)
    STUB(GetUInt8) STUB(GetInt16) STUB(GetUInt16) STUB(GetUInt32) STUB(GetInt64) STUB(GetUInt64) STUB(GetString)
    STUB(GetBinary) STUB(GetClock) STUB(SetFloat32) STUB(SetInt8) STUB(SetUInt8) STUB(SetInt16) STUB(SetUInt16)
    STUB(SetUInt32) STUB(SetInt64) STUB(SetUInt64) STUB(SetString) STUB(SetBinary) STUB(SetClock)
    STUB(GetNumberOfVariableDependencies) STUB(GetVariableDependencies) STUB(GetFMUState) STUB(SetFMUState)
    STUB(FreeFMUState) STUB(SerializedFMUStateSize) STUB(SerializeFMUState) STUB(DeserializeFMUState)
    STUB(GetDirectionalDerivative) STUB(GetAdjointDerivative) STUB(EnterConfigurationMode) STUB(ExitConfigurationMode)
    STUB(GetIntervalDecimal) STUB(GetIntervalFraction) STUB(GetShiftDecimal) STUB(GetShiftFraction)
    STUB(SetIntervalDecimal) STUB(SetIntervalFraction) STUB(SetShiftDecimal) STUB(SetShiftFraction)
    STUB(EvaluateDiscreteStates) STUB(UpdateDiscreteStates) STUB(EnterEventMode) STUB(EnterStepMode)
    STUB(EnterContinuousTimeMode) STUB(CompletedIntegratorStep) STUB(SetTime) STUB(SetContinuousStates)
    STUB(GetContinuousStateDerivatives) STUB(GetEventIndicators) STUB(GetContinuousStates)
    STUB(GetNominalsOfContinuousStates) STUB(GetNumberOfEventIndicators) STUB(GetNumberOfContinuousStates)
    STUB(GetOutputDerivatives) STUB(ActivateModelPartition)
#endif
