/* Three FMUs of FMI 2.0 for model exchange and co-simulation, which `fmu_problem.py` describes and compiles.
 *
 * -DVANDERPOL:  der(x0) = x1,  der(x1) = mu (1 - x0^2) x1 - x0,  x0(0) = 2,  x1(0) = 0
 * -DLAG:        der(y) = (gain u - y) / tau,  y(0) = gain u(0)
 * -DEXHAUST:    der(T) = (settled - T) / constant,  T(0) = settled(0),  settled = map(speed, injection) of ROWS x COLUMNS
 *               values and constant = curve(air) of POINTS values, all on even grids over 0 to 1, continued linearly
 *
 * The values are states, derivatives, inputs and parameters, in this order; the value reference of the time is 0.
 * VANDERPOL and LAG have directional derivatives along states and inputs only, EXHAUST along parameters as well.
 * A step of co-simulation is SUBSTEPS steps of Euler's method.
 */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#if defined VANDERPOL
enum { STATES = 2, INPUTS = 0, PARAMETERS = 1 };
#elif defined LAG
enum { STATES = 1, INPUTS = 1, PARAMETERS = 2 };
#else
enum { STATES = 1, INPUTS = 3, PARAMETERS = ROWS * COLUMNS + POINTS };
#endif
enum { SUBSTEPS = 10 };
enum { X = 1, DER = X + STATES, U = DER + STATES, P = U + INPUTS, END = P + PARAMETERS };

typedef struct {
    double values[END];
    int initialized;
} Model;

#ifdef EXHAUST
static int bracket(double x, int count, double *share) {
    int left = (int)floor(x * (count - 1));
    left = left < 0 ? 0 : left > count - 2 ? count - 2 : left;
    *share = x * (count - 1) - left;
    return left;
}

/* the value of the map and its weights at the four corners */
static double settled(const double *v, int at[4], double weights[4]) {
    double a, b, sum = 0.0;
    int row = bracket(v[U], ROWS, &a), column = bracket(v[U + 1], COLUMNS, &b);
    for (int k = 0; k < 4; k++) {
        at[k] = (row + k / 2) * COLUMNS + column + k % 2;
        weights[k] = (k / 2 ? a : 1 - a) * (k % 2 ? b : 1 - b);
        sum += weights[k] * v[P + at[k]];
    }
    return sum;
}

static double constant(const double *v, int *left, double *share) {
    const double *curve = v + P + ROWS * COLUMNS;
    *left = bracket(v[U + 2], POINTS, share);
    return (1 - *share) * curve[*left] + *share * curve[*left + 1];
}
#endif

static void derive(double *v) {
#if defined VANDERPOL
    v[DER] = v[X + 1];
    v[DER + 1] = v[P] * (1 - v[X] * v[X]) * v[X + 1] - v[X];
#elif defined LAG
    v[DER] = (v[P + 1] * v[U] - v[X]) / v[P];
#else
    int at[4], left;
    double weights[4], share;
    v[DER] = (settled(v, at, weights) - v[X]) / constant(v, &left, &share);
#endif
}

static double partial(const double *v, unsigned unknown, unsigned known) {
    if (known == unknown) return 1.0;
#if defined VANDERPOL
    if (unknown == DER) return known == X + 1;
    if (unknown == DER + 1 && known == X) return -2 * v[P] * v[X] * v[X + 1] - 1;
    if (unknown == DER + 1 && known == X + 1) return v[P] * (1 - v[X] * v[X]);
#elif defined LAG
    if (unknown == DER && known == X) return -1 / v[P];
    if (unknown == DER && known == U) return v[P + 1] / v[P];
#else
    int at[4], left;
    double weights[4], share, slow = constant(v, &left, &share), base = settled(v, at, weights);
    if (unknown != DER) return 0.0;
    if (known == X) return -1 / slow;
    if (known >= P + ROWS * COLUMNS) {
        int k = (int)known - P - ROWS * COLUMNS;
        return -(base - v[X]) / (slow * slow) * (k == left ? 1 - share : k == left + 1 ? share : 0.0);
    }
    for (int k = 0; k < 4; k++)
        if (known == (unsigned)(P + at[k])) return weights[k] / slow;
#endif
    return 0.0;
}

static void start(double *v) {
    memset(v, 0, END * sizeof *v);
#if defined VANDERPOL
    v[X] = 2.0;
    v[P] = 1.0;
#elif defined LAG
    v[P] = v[P + 1] = 1.0;
#else
    for (int k = 0; k < PARAMETERS; k++) v[P + k] = k < ROWS * COLUMNS ? 230.0 : 5.0;
#endif
}

static void initialize(double *v) {
#if defined LAG
    v[X] = v[P + 1] * v[U];
#elif defined EXHAUST
    int at[4];
    double weights[4];
    v[X] = settled(v, at, weights);
#endif
    (void)v;
}

#define M ((Model *)c)
typedef struct { int needed, terminate, nominals, values, timed; double time; } EventInfo;
void *fmi2Instantiate(const char *n, int type, const char *guid, const char *r, const void *k, int v, int l) {
    Model *c = strcmp(guid, "{models}") == 0 ? calloc(1, sizeof(Model)) : NULL;
    if (c) start(c->values);
    return c;
}
void fmi2FreeInstance(void *c) { free(c); }
int fmi2Reset(void *c) { start(M->values); return 0; }
int fmi2SetupExperiment(void *c, int d, double t, double s, int e, double stop) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { initialize(M->values); return 0; }
int fmi2EnterEventMode(void *c) { return 0; }
int fmi2EnterContinuousTimeMode(void *c) { return 0; }
int fmi2NewDiscreteStates(void *c, EventInfo *info) { memset(info, 0, sizeof *info); return 0; }
int fmi2CompletedIntegratorStep(void *c, int n, int *event, int *end) { *event = *end = 0; return 0; }
int fmi2Terminate(void *c) { return 0; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const *names) { return 0; }
int fmi2SetTime(void *c, double t) { M->values[0] = t; return 0; }
int fmi2SetContinuousStates(void *c, const double *x, size_t n) { memcpy(M->values + X, x, n * sizeof *x); return 0; }
int fmi2GetContinuousStates(void *c, double *x, size_t n) { memcpy(x, M->values + X, n * sizeof *x); return 0; }
int fmi2GetDerivatives(void *c, double *d, size_t n) {
    derive(M->values);
    memcpy(d, M->values + DER, n * sizeof *d);
    return 0;
}
int fmi2DoStep(void *c, double t, double step, int kept) {
    for (int k = 0; k < SUBSTEPS; k++) {
        derive(M->values);
        for (int i = 0; i < STATES; i++) M->values[X + i] += step / SUBSTEPS * M->values[DER + i];
    }
    return 0;
}
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) M->values[r[i]] = v[i];
    return 0;
}
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = M->values[r[i]];
    return 0;
}
int fmi2GetDirectionalDerivative(void *c, const unsigned *u, size_t nu, const unsigned *k, size_t nk, const double *s,
                                 double *d) {
    for (size_t i = 0; i < nu; i++) {
        d[i] = 0.0;
        for (size_t j = 0; j < nk; j++) d[i] += partial(M->values, u[i], k[j]) * s[j];
    }
    return 0;
}

/* functions that tools look for, and that nobody calls here */
#define STUB(name) int fmi2##name(void) { return 0; }
STUB(GetTypesPlatform) STUB(GetVersion) STUB(GetInteger) STUB(GetBoolean) STUB(GetString) STUB(SetInteger)
STUB(SetBoolean) STUB(SetString) STUB(GetFMUstate) STUB(SetFMUstate) STUB(FreeFMUstate) STUB(SerializedFMUstateSize)
STUB(SerializeFMUstate) STUB(DeSerializeFMUstate) STUB(GetEventIndicators) STUB(GetNominalsOfContinuousStates)
STUB(SetRealInputDerivatives) STUB(GetRealOutputDerivatives) STUB(CancelStep) STUB(GetStatus)
STUB(GetRealStatus) STUB(GetIntegerStatus) STUB(GetBooleanStatus) STUB(GetStringStatus)
