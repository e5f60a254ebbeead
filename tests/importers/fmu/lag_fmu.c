/* A lag with a table, as an FMU for model exchange of FMI 2.0 (-DFMI=2) or 3.0 (-DFMI=3).
 *
 *   der(x) = (u - x) / tau,  x(0) = k,  y = k x + sum of (10 i + j) table[i,j],  2 rows, COLUMNS columns, which are 3
 *
 * tau is fixed: it takes effect at initialization only, and tau <= 0 is an error. Directional derivatives are right along
 * x and u, and 0 along parameters. With -DSTATE_EVENT x becomes 1 at x > 2, with -DENDING the simulation ends there, with
 * -DMEMORY y is higher once x was above 1.5, and with -DSTART the value of x at the start is set instead of k.
 * With -DLIFT a local variable `lift`, whose start is 0.35, is added to y where x > 1.2; -DLOST_START makes a reset lose
 * its start, so that it is 0 from there on.
 * -DIN_LOADING, -DIN_INSTANTIATE, -DIN_GET and -DIN_UNLOADING hold statements that run at these places first; IN_GET may
 * use m.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#ifdef IN_GET
#include <signal.h>
#include <stdio.h>
#include <unistd.h>
#endif

#ifndef COLUMNS
#define COLUMNS 3
#endif
enum { TIME, X, DER_X, U, Y, TAU, K, TABLE, LIFT_REFERENCE = 40, VALUES = 2 * COLUMNS };
typedef struct {
    double time, x, u, tau, k, table[VALUES], used_tau, lift;
    int initialized, high;
} Lag;

static void start(Lag *m) {
    int high = m->high;  /* kept over resets */
    memset(m, 0, sizeof *m);
    m->high = high;
    m->tau = 2.0;
    m->k = 1.0;
    for (int i = 0; i < VALUES; i++) m->table[i] = i;
#ifdef LIFT
    m->lift = 0.35;
#endif
}

static void reset(Lag *m) {
    start(m);
#ifdef LOST_START
    m->lift = 0.0;
#endif
}

#ifndef IN_INSTANTIATE
#define IN_INSTANTIATE
#endif
#ifndef IN_GET
#define IN_GET
#endif
#ifdef IN_LOADING
__attribute__((constructor)) static void load(void) { IN_LOADING; }
#endif
#ifdef IN_UNLOADING
__attribute__((destructor)) static void unload(void) { IN_UNLOADING; }
#endif

static int overflow(int depth) {
    volatile char buffer[4096];
    buffer[0] = (char)depth;
    return overflow(depth + 1) + buffer[0];
}

static int get(Lag *m, unsigned reference, double *value) {
    IN_GET;
    double y = m->k * m->x + m->high + (m->x > 1.2 ? m->lift : 0.0);
    for (int i = 0; i < VALUES; i++) y += (10 * (i / COLUMNS + 1) + i % COLUMNS + 1) * m->table[i];
    if (m->used_tau <= 0.0) return 3;
    switch (reference) {
    case X: *value = m->x; return 0;
    case DER_X: *value = (m->u - m->x) / m->used_tau; return 0;
    case Y: *value = y; return 0;
    case LIFT_REFERENCE: *value = m->lift; return 0;
    default: return 3;
    }
}

static int set(Lag *m, unsigned reference, double value) {
    if (reference == U) m->u = value;
    else if (reference == TAU && !m->initialized) m->tau = value;
    else if (reference == K) m->k = value;
    else if (reference >= TABLE && reference < TABLE + VALUES) m->table[reference - TABLE] = value;
#ifdef START
    else if (reference == X && !m->initialized) m->x = value;
#endif
    else return reference == TAU ? 0 : 3;
    return 0;
}

static double partial(Lag *m, unsigned unknown, unsigned known) {
    if (unknown == DER_X && known == X) return -1.0 / m->used_tau;
    if (unknown == DER_X && known == U) return 1.0 / m->used_tau;
    return unknown == Y && known == X ? m->k : 0.0;
}

static int finish_initialization(Lag *m) {
    m->initialized = 1;
    m->used_tau = m->tau;
#ifndef START
    m->x = m->k;
#endif
    return 0;
}

static int update(Lag *m) {
#ifdef STATE_EVENT
    if (m->x > 2.0) { m->x = 1.0; return 1; }
#endif
    (void)m;
    return 0;
}

static int is_ended(Lag *m) {
#ifdef ENDING
    return m->x > 2.0;
#endif
    (void)m;
    return 0;
}

#define LAG(c) ((Lag *)(c))
#if FMI == 2
#define F(name) fmi2##name
#define BOOL int
typedef struct { int needed, terminate, nominals, values, timed; double time; } EventInfo;
void *fmi2Instantiate(const char *n, int type, const char *guid, const char *r, const void *c, int v, int l) {
    IN_INSTANTIATE;
    Lag *m = strcmp(guid, "{lag}") == 0 ? calloc(1, sizeof(Lag)) : NULL;
    if (m) start(m);
    return m;
}
int fmi2SetupExperiment(void *c, int d, double t, double s, int e, double stop) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2NewDiscreteStates(void *c, EventInfo *info) {
    EventInfo result = {0, is_ended(c), 0, update(c), 0, 1.0};
    *info = result;
    return 0;
}
int fmi2GetDerivatives(void *c, double *d, size_t n) { return get(c, DER_X, d); }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) {
    int status = 0;
    for (size_t i = 0; i < n; i++) status |= set(c, r[i], v[i]);
    return status;
}
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) {
    int status = 0;
    for (size_t i = 0; i < n; i++) status |= get(c, r[i], v + i);
    return status;
}
int fmi2GetDirectionalDerivative(void *c, const unsigned *u, size_t nu, const unsigned *k, size_t nk, const double *s,
                                 double *d) {
    for (size_t i = 0; i < nu; i++) {
        d[i] = 0;
        for (size_t j = 0; j < nk; j++) d[i] += partial(c, u[i], k[j]) * s[j];
    }
    return 0;
}
#else
#define F(name) fmi3##name
#define BOOL bool
void *fmi3InstantiateModelExchange(const char *n, const char *token, const char *r, bool v, bool l, void *e, void *log) {
    IN_INSTANTIATE;
    Lag *m = strcmp(token, "{lag}") == 0 ? calloc(1, sizeof(Lag)) : NULL;
    if (m) start(m);
    return m;
}
int fmi3EnterInitializationMode(void *c, bool d, double t, double s, bool e, double stop) { return 0; }
int fmi3UpdateDiscreteStates(void *c, bool *needed, bool *end, bool *nominals, bool *values, bool *timed, double *t) {
    *needed = *nominals = *timed = false;
    *end = is_ended(c);
    *values = update(c);
    return 0;
}
int fmi3GetContinuousStateDerivatives(void *c, double *d, size_t n) { return get(c, DER_X, d); }
int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *v, size_t nv) {
    int status = 0;
    for (size_t i = 0, at = 0; i < n; i++)
        for (unsigned k = 0; k < (r[i] == TABLE ? (unsigned)VALUES : 1u); k++) status |= set(c, r[i] + k, v[at++]);
    return status;
}
int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *v, size_t nv) {
    int status = 0;
    for (size_t i = 0; i < n; i++) status |= get(c, r[i], v + i);
    return status;
}
int fmi3GetDirectionalDerivative(void *c, const unsigned *u, size_t nu, const unsigned *k, size_t nk, const double *s,
                                 size_t ns, double *d, size_t nd) {
    for (size_t i = 0; i < nu; i++) d[i] = ns == 1 ? partial(c, u[i], k[0]) * s[0] : 0.0;
    return 0;
}
#endif

int F(Reset)(void *c) { reset(LAG(c)); return 0; }
int F(ExitInitializationMode)(void *c) { return finish_initialization(c); }
int F(EnterEventMode)(void *c) { return 0; }
int F(EnterContinuousTimeMode)(void *c) { return 0; }
int F(SetTime)(void *c, double t) { LAG(c)->time = t; return 0; }
int F(SetContinuousStates)(void *c, const double *x, size_t n) {
    LAG(c)->x = x[0];
#ifdef MEMORY
    LAG(c)->high |= x[0] > 1.5;
#endif
    return 0;
}
int F(GetContinuousStates)(void *c, double *x, size_t n) { x[0] = LAG(c)->x; return 0; }
int F(CompletedIntegratorStep)(void *c, BOOL n, BOOL *event, BOOL *end) { *event = *end = 0; return 0; }
int F(Terminate)(void *c) { return 0; }
void F(FreeInstance)(void *c) { free(c); }
#if FMI == 2
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const *names) { return 0; }
#else
int fmi3SetDebugLogging(void *c, bool on, size_t n, const char *const *names) { return 0; }
#endif

/* functions that tools look for, and that nobody calls here */
#define STUB(name) int F(name)(void) { return 0; }
#if FMI == 2
    STUB(GetTypesPlatform) STUB(GetVersion) STUB(GetInteger) STUB(GetBoolean) STUB(GetString) STUB(SetInteger)
    STUB(SetBoolean) STUB(SetString) STUB(GetFMUstate) STUB(SetFMUstate) STUB(FreeFMUstate)
    STUB(SerializedFMUstateSize) STUB(SerializeFMUstate) STUB(DeSerializeFMUstate) STUB(GetEventIndicators)
    STUB(GetNominalsOfContinuousStates) STUB(SetRealInputDerivatives) STUB(GetRealOutputDerivatives) STUB(DoStep)
    STUB(CancelStep) STUB(GetStatus) STUB(GetRealStatus) STUB(GetIntegerStatus) STUB(GetBooleanStatus)
    STUB(GetStringStatus)
#else
    STUB(GetVersion) STUB(InstantiateCoSimulation) STUB(InstantiateScheduledExecution) STUB(GetFloat32) STUB(GetInt8)
    STUB(GetUInt8) STUB(GetInt16) STUB(GetUInt16) STUB(GetInt32) STUB(GetUInt32) STUB(GetInt64) STUB(GetUInt64)
    STUB(GetBoolean) STUB(GetString) STUB(GetBinary) STUB(GetClock) STUB(SetFloat32) STUB(SetInt8) STUB(SetUInt8)
    STUB(SetInt16) STUB(SetUInt16) STUB(SetInt32) STUB(SetUInt32) STUB(SetInt64) STUB(SetUInt64) STUB(SetBoolean)
    STUB(SetString) STUB(SetBinary) STUB(SetClock) STUB(GetNumberOfVariableDependencies) STUB(GetVariableDependencies)
    STUB(GetFMUState) STUB(SetFMUState) STUB(FreeFMUState) STUB(SerializedFMUStateSize) STUB(SerializeFMUState)
    STUB(DeserializeFMUState) STUB(GetAdjointDerivative) STUB(EnterConfigurationMode) STUB(ExitConfigurationMode)
    STUB(GetIntervalDecimal) STUB(GetIntervalFraction) STUB(GetShiftDecimal) STUB(GetShiftFraction)
    STUB(SetIntervalDecimal) STUB(SetIntervalFraction) STUB(SetShiftDecimal) STUB(SetShiftFraction)
    STUB(EvaluateDiscreteStates) STUB(GetEventIndicators) STUB(GetNominalsOfContinuousStates)
    STUB(GetNumberOfEventIndicators) STUB(GetNumberOfContinuousStates) STUB(EnterStepMode) STUB(GetOutputDerivatives)
    STUB(DoStep) STUB(ActivateModelPartition)
#endif
