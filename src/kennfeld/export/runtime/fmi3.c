/* FMI 3.0 of an exported function: co-simulation, and model exchange of a function without memory. */

#include <stdbool.h>

#include "core.h"

typedef void *component;
typedef uint32_t reference;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*log_message)(void *, fmi3Status, const char *, const char *);
typedef void (*intermediate_update)(void *, double, bool, bool, bool, bool, bool *, double *);

typedef struct {
    instance_data data;
    log_message log;
    void *environment;
} instance;

/* a stored state begins with it, so that bytes of another FMU are refused */
static const char token[] = TOKEN;

static fmi3Status fail(const instance *q, const char *message)
{
    if (q->log != NULL) {
        q->log(q->environment, fmi3Error, "logStatusError", message);
    }
    return fmi3Error;
}

static component create(const char *given, log_message log, void *environment, bool allowed)
{
    instance *q = (instance *)calloc(1, sizeof(instance));

    if (q == NULL) {
        return NULL;
    }
    q->log = log;
    q->environment = environment;
    if ((given == NULL) || (strcmp(given, TOKEN) != 0)) {
        (void)fail(q, "the instantiation token is not " TOKEN " of this FMU");
    } else if (!allowed) {
        (void)fail(q, "a function with memory is for co-simulation only");
    } else {
        reset_data(&q->data);
        return q;
    }
    free(q);
    return NULL;
}

EXPORTED const char * fmi3GetVersion(void);
EXPORTED const char * fmi3GetVersion(void)
{
    return "3.0";
}

EXPORTED fmi3Status fmi3SetDebugLogging(component c, bool on, size_t n, const char *const categories[]);
EXPORTED fmi3Status fmi3SetDebugLogging(component c, bool on, size_t n, const char *const categories[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)categories;
    return fmi3OK;
}

EXPORTED component fmi3InstantiateModelExchange(const char *name, const char *given, const char *resources,
    bool visible, bool logging, void *environment, log_message log);
EXPORTED component fmi3InstantiateModelExchange(const char *name, const char *given, const char *resources,
    bool visible, bool logging, void *environment, log_message log)
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    return create(given, log, environment, HAS_MEMORY == 0);
}

EXPORTED component fmi3InstantiateCoSimulation(const char *name, const char *given, const char *resources,
    bool visible, bool logging, bool events, bool early, const reference required[], size_t n,
    void *environment, log_message log, intermediate_update update);
EXPORTED component fmi3InstantiateCoSimulation(const char *name, const char *given, const char *resources,
    bool visible, bool logging, bool events, bool early, const reference required[], size_t n,
    void *environment, log_message log, intermediate_update update)
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)events;
    (void)early;
    (void)required;
    (void)n;
    (void)update;
    return create(given, log, environment, true);
}

EXPORTED component fmi3InstantiateScheduledExecution(const char *name, const char *given, const char *resources,
    bool visible, bool logging, void *environment, log_message log, void (*clock)(void *), void (*lock)(void),
    void (*unlock)(void));
EXPORTED component fmi3InstantiateScheduledExecution(const char *name, const char *given, const char *resources,
    bool visible, bool logging, void *environment, log_message log, void (*clock)(void *), void (*lock)(void),
    void (*unlock)(void))
{
    (void)name;
    (void)given;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)log;
    (void)clock;
    (void)lock;
    (void)unlock;
    return NULL;
}

EXPORTED void fmi3FreeInstance(component c);
EXPORTED void fmi3FreeInstance(component c)
{
    free(c);
}

EXPORTED fmi3Status fmi3EnterInitializationMode(component c, bool tolerant, double tolerance, double start,
    bool ends, double stop);
EXPORTED fmi3Status fmi3EnterInitializationMode(component c, bool tolerant, double tolerance, double start,
    bool ends, double stop)
{
    instance *q = (instance *)c;

    (void)tolerant;
    (void)tolerance;
    (void)ends;
    (void)stop;
    if (q->data.now != PHASE_CREATED) {
        return fail(q, "fmi3EnterInitializationMode: only once, until fmi3Reset");
    }
    q->data.start = start;
    q->data.time = start;
    q->data.stale = 1;
    q->data.now = PHASE_INITIALIZING;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3ExitInitializationMode(component c);
EXPORTED fmi3Status fmi3ExitInitializationMode(component c)
{
    instance *q = (instance *)c;

    if (q->data.now != PHASE_INITIALIZING) {
        return fail(q, "fmi3ExitInitializationMode: only after fmi3EnterInitializationMode");
    }
    end_initialization(&q->data);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3EnterEventMode(component c);
EXPORTED fmi3Status fmi3EnterEventMode(component c)
{
    (void)c;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3EnterConfigurationMode(component c);
EXPORTED fmi3Status fmi3EnterConfigurationMode(component c)
{
    (void)c;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3ExitConfigurationMode(component c);
EXPORTED fmi3Status fmi3ExitConfigurationMode(component c)
{
    (void)c;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3EnterStepMode(component c);
EXPORTED fmi3Status fmi3EnterStepMode(component c)
{
    (void)c;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3EnterContinuousTimeMode(component c);
EXPORTED fmi3Status fmi3EnterContinuousTimeMode(component c)
{
    (void)c;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3EvaluateDiscreteStates(component c);
EXPORTED fmi3Status fmi3EvaluateDiscreteStates(component c)
{
    (void)c;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3Terminate(component c);
EXPORTED fmi3Status fmi3Terminate(component c)
{
    ((instance *)c)->data.now = PHASE_ENDED;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3Reset(component c);
EXPORTED fmi3Status fmi3Reset(component c)
{
    reset_data(&((instance *)c)->data);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetFloat64(component c, const reference r[], size_t n, double v[], size_t size);
EXPORTED fmi3Status fmi3GetFloat64(component c, const reference r[], size_t n, double v[], size_t size)
{
    instance *q = (instance *)c;

    if (get_values(&q->data, r, n, v, size) == 0) {
        return fail(q, "fmi3GetFloat64: unknown value reference, or another number of values");
    }
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SetFloat64(component c, const reference r[], size_t n, const double v[], size_t size);
EXPORTED fmi3Status fmi3SetFloat64(component c, const reference r[], size_t n, const double v[], size_t size)
{
    instance *q = (instance *)c;

    if (set_values(&q->data, r, n, v, size) == 0) {
        return fail(q, "fmi3SetFloat64: not an input or a parameter, or another number of values");
    }
    return fmi3OK;
}

/* there are variables of type Float64 only */
#define NO_VARIABLES(NAME, TYPE)                                                                                       \
    EXPORTED fmi3Status fmi3Get##NAME(component c, const reference r[], size_t n, TYPE v[], size_t size);              \
    EXPORTED fmi3Status fmi3Set##NAME(component c, const reference r[], size_t n, const TYPE v[], size_t size);        \
    EXPORTED fmi3Status fmi3Get##NAME(component c, const reference r[], size_t n, TYPE v[], size_t size)               \
    {                                                                                                                  \
        (void)r;                                                                                                       \
        (void)v;                                                                                                       \
        (void)size;                                                                                                    \
        return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3Get" #NAME ": the FMU has variables of type Float64 only"); \
    }                                                                                                                  \
    EXPORTED fmi3Status fmi3Set##NAME(component c, const reference r[], size_t n, const TYPE v[], size_t size)         \
    {                                                                                                                  \
        (void)r;                                                                                                       \
        (void)v;                                                                                                       \
        (void)size;                                                                                                    \
        return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3Set" #NAME ": the FMU has variables of type Float64 only"); \
    }

typedef const char *text;

NO_VARIABLES(Float32, float)
NO_VARIABLES(Int8, int8_t)
NO_VARIABLES(UInt8, uint8_t)
NO_VARIABLES(Int16, int16_t)
NO_VARIABLES(UInt16, uint16_t)
NO_VARIABLES(Int32, int32_t)
NO_VARIABLES(UInt32, uint32_t)
NO_VARIABLES(Int64, int64_t)
NO_VARIABLES(UInt64, uint64_t)
NO_VARIABLES(Boolean, bool)
NO_VARIABLES(String, text)

EXPORTED fmi3Status fmi3GetBinary(component c, const reference r[], size_t n, size_t sizes[],
    const uint8_t * v[], size_t size);
EXPORTED fmi3Status fmi3GetBinary(component c, const reference r[], size_t n, size_t sizes[],
    const uint8_t * v[], size_t size)
{
    (void)r;
    (void)sizes;
    (void)v;
    (void)size;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetBinary: the FMU has variables of type Float64 only");
}

EXPORTED fmi3Status fmi3GetClock(component c, const reference r[], size_t n, bool v[]);
EXPORTED fmi3Status fmi3GetClock(component c, const reference r[], size_t n, bool v[])
{
    (void)r;
    (void)v;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetClock: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3SetBinary(component c, const reference r[], size_t n, const size_t sizes[],
    const uint8_t *const v[], size_t size);
EXPORTED fmi3Status fmi3SetBinary(component c, const reference r[], size_t n, const size_t sizes[],
    const uint8_t *const v[], size_t size)
{
    (void)r;
    (void)sizes;
    (void)v;
    (void)size;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetBinary: the FMU has variables of type Float64 only");
}

EXPORTED fmi3Status fmi3SetClock(component c, const reference r[], size_t n, const bool v[]);
EXPORTED fmi3Status fmi3SetClock(component c, const reference r[], size_t n, const bool v[])
{
    (void)r;
    (void)v;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetClock: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3GetIntervalDecimal(component c, const reference r[], size_t n, double a[], int b[]);
EXPORTED fmi3Status fmi3GetIntervalDecimal(component c, const reference r[], size_t n, double a[], int b[])
{
    (void)r;
    (void)a;
    (void)b;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetIntervalDecimal: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3GetIntervalFraction(component c, const reference r[], size_t n, uint64_t a[],
    uint64_t b[], int d[]);
EXPORTED fmi3Status fmi3GetIntervalFraction(component c, const reference r[], size_t n, uint64_t a[],
    uint64_t b[], int d[])
{
    (void)r;
    (void)a;
    (void)b;
    (void)d;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetIntervalFraction: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3GetShiftDecimal(component c, const reference r[], size_t n, double a[]);
EXPORTED fmi3Status fmi3GetShiftDecimal(component c, const reference r[], size_t n, double a[])
{
    (void)r;
    (void)a;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetShiftDecimal: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3GetShiftFraction(component c, const reference r[], size_t n, uint64_t a[], uint64_t b[]);
EXPORTED fmi3Status fmi3GetShiftFraction(component c, const reference r[], size_t n, uint64_t a[], uint64_t b[])
{
    (void)r;
    (void)a;
    (void)b;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetShiftFraction: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3SetIntervalDecimal(component c, const reference r[], size_t n, const double a[]);
EXPORTED fmi3Status fmi3SetIntervalDecimal(component c, const reference r[], size_t n, const double a[])
{
    (void)r;
    (void)a;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetIntervalDecimal: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3SetIntervalFraction(component c, const reference r[], size_t n, const uint64_t a[],
    const uint64_t b[]);
EXPORTED fmi3Status fmi3SetIntervalFraction(component c, const reference r[], size_t n, const uint64_t a[],
    const uint64_t b[])
{
    (void)r;
    (void)a;
    (void)b;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetIntervalFraction: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3SetShiftDecimal(component c, const reference r[], size_t n, const double a[]);
EXPORTED fmi3Status fmi3SetShiftDecimal(component c, const reference r[], size_t n, const double a[])
{
    (void)r;
    (void)a;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetShiftDecimal: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3SetShiftFraction(component c, const reference r[], size_t n, const uint64_t a[],
    const uint64_t b[]);
EXPORTED fmi3Status fmi3SetShiftFraction(component c, const reference r[], size_t n, const uint64_t a[],
    const uint64_t b[])
{
    (void)r;
    (void)a;
    (void)b;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetShiftFraction: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3ActivateModelPartition(component c, reference clock, double time);
EXPORTED fmi3Status fmi3ActivateModelPartition(component c, reference clock, double time)
{
    (void)clock;
    (void)time;
    return fail((instance *)c, "fmi3ActivateModelPartition: the FMU has no clocks");
}

EXPORTED fmi3Status fmi3GetNumberOfVariableDependencies(component c, reference r, size_t *n);
EXPORTED fmi3Status fmi3GetNumberOfVariableDependencies(component c, reference r, size_t *n)
{
    (void)r;
    (void)n;
    return fail((instance *)c, "fmi3GetNumberOfVariableDependencies: see the description");
}

EXPORTED fmi3Status fmi3GetVariableDependencies(component c, reference r, size_t own[], reference others[],
    size_t their[], int kinds[], size_t n);
EXPORTED fmi3Status fmi3GetVariableDependencies(component c, reference r, size_t own[], reference others[],
    size_t their[], int kinds[], size_t n)
{
    (void)r;
    (void)own;
    (void)others;
    (void)their;
    (void)kinds;
    (void)n;
    return fail((instance *)c, "fmi3GetVariableDependencies: see the description");
}

EXPORTED fmi3Status fmi3GetFMUState(component c, void **state);
EXPORTED fmi3Status fmi3GetFMUState(component c, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(instance_data));
    }
    if (*state == NULL) {
        return fail((instance *)c, "fmi3GetFMUState: not enough memory");
    }
    memcpy(*state, &((instance *)c)->data, sizeof(instance_data));
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SetFMUState(component c, void *state);
EXPORTED fmi3Status fmi3SetFMUState(component c, void *state)
{
    if (state == NULL) {
        return fail((instance *)c, "fmi3SetFMUState: there is no state");
    }
    memcpy(&((instance *)c)->data, state, sizeof(instance_data));
    return fmi3OK;
}

EXPORTED fmi3Status fmi3FreeFMUState(component c, void **state);
EXPORTED fmi3Status fmi3FreeFMUState(component c, void **state)
{
    (void)c;
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SerializedFMUStateSize(component c, void *state, size_t *size);
EXPORTED fmi3Status fmi3SerializedFMUStateSize(component c, void *state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(token) + sizeof(instance_data);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SerializeFMUState(component c, void *state, uint8_t bytes[], size_t size);
EXPORTED fmi3Status fmi3SerializeFMUState(component c, void *state, uint8_t bytes[], size_t size)
{
    if ((state == NULL) || (size < (sizeof(token) + sizeof(instance_data)))) {
        return fail((instance *)c, "fmi3SerializeFMUState: there is no state, or too little room");
    }
    memcpy(bytes, token, sizeof(token));
    memcpy(&bytes[sizeof(token)], state, sizeof(instance_data));
    return fmi3OK;
}

EXPORTED fmi3Status fmi3DeserializeFMUState(component c, const uint8_t bytes[], size_t size, void **state);
EXPORTED fmi3Status fmi3DeserializeFMUState(component c, const uint8_t bytes[], size_t size, void **state)
{
    if ((size != (sizeof(token) + sizeof(instance_data))) || (memcmp(bytes, token, sizeof(token)) != 0)) {
        return fail((instance *)c, "fmi3DeserializeFMUState: not a state of this FMU");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(instance_data));
    }
    if (*state == NULL) {
        return fail((instance *)c, "fmi3DeserializeFMUState: not enough memory");
    }
    memcpy(*state, &bytes[sizeof(token)], sizeof(instance_data));
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetDirectionalDerivative(component c, const reference unknowns[], size_t unknown_count,
    const reference knowns[], size_t known_count, const double seed[], size_t seeds, double sensitivity[],
    size_t sensitivities);
EXPORTED fmi3Status fmi3GetDirectionalDerivative(component c, const reference unknowns[], size_t unknown_count,
    const reference knowns[], size_t known_count, const double seed[], size_t seeds, double sensitivity[],
    size_t sensitivities)
{
    instance *q = (instance *)c;

    if (get_derivative(
            &q->data, unknowns, unknown_count, knowns, known_count, seed, seeds, sensitivity, sensitivities) == 0) {
        return fail(q, "fmi3GetDirectionalDerivative: of outputs by inputs and parameters only");
    }
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetAdjointDerivative(component c, const reference unknowns[], size_t unknown_count,
    const reference knowns[], size_t known_count, const double seed[], size_t seeds, double sensitivity[],
    size_t sensitivities);
EXPORTED fmi3Status fmi3GetAdjointDerivative(component c, const reference unknowns[], size_t unknown_count,
    const reference knowns[], size_t known_count, const double seed[], size_t seeds, double sensitivity[],
    size_t sensitivities)
{
    (void)unknowns;
    (void)unknown_count;
    (void)knowns;
    (void)known_count;
    (void)seed;
    (void)seeds;
    (void)sensitivity;
    (void)sensitivities;
    return fail((instance *)c, "fmi3GetAdjointDerivative: not provided");
}

EXPORTED fmi3Status fmi3UpdateDiscreteStates(component c, bool *again, bool *ends, bool *nominals, bool *states,
    bool *defined, double *next);
EXPORTED fmi3Status fmi3UpdateDiscreteStates(component c, bool *again, bool *ends, bool *nominals, bool *states,
    bool *defined, double *next)
{
    (void)c;
    *again = false;
    *ends = false;
    *nominals = false;
    *states = false;
    *defined = false;
    *next = 0.0;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3DoStep(component c, double time, double step, bool keeps, bool *event, bool *ends,
    bool *early, double *last);
EXPORTED fmi3Status fmi3DoStep(component c, double time, double step, bool keeps, bool *event, bool *ends,
    bool *early, double *last)
{
    instance *q = (instance *)c;

    (void)keeps;
    *event = false;
    *ends = false;
    *early = false;
    *last = time;
    if (q->data.now != PHASE_RUNNING) {
        return fail(q, "fmi3DoStep: only after the initialization");
    }
    if (is_allowed(step) == 0) {
        return fail(q, "fmi3DoStep: " STEP_RULE);
    }
    do_step(&q->data, time, step);
    *last = time + step;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetOutputDerivatives(component c, const reference r[], size_t n, const int32_t orders[],
    double v[], size_t size);
EXPORTED fmi3Status fmi3GetOutputDerivatives(component c, const reference r[], size_t n, const int32_t orders[],
    double v[], size_t size)
{
    (void)r;
    (void)orders;
    (void)v;
    (void)size;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetOutputDerivatives: outputs have no derivatives in time");
}

/* model exchange without continuous states and events */

EXPORTED fmi3Status fmi3SetTime(component c, double time);
EXPORTED fmi3Status fmi3SetTime(component c, double time)
{
    ((instance *)c)->data.time = time;
    ((instance *)c)->data.stale = 1;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3CompletedIntegratorStep(component c, bool keeps, bool *event, bool *ends);
EXPORTED fmi3Status fmi3CompletedIntegratorStep(component c, bool keeps, bool *event, bool *ends)
{
    (void)c;
    (void)keeps;
    *event = false;
    *ends = false;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetNumberOfEventIndicators(component c, size_t *n);
EXPORTED fmi3Status fmi3GetNumberOfEventIndicators(component c, size_t *n)
{
    (void)c;
    *n = 0;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetNumberOfContinuousStates(component c, size_t *n);
EXPORTED fmi3Status fmi3GetNumberOfContinuousStates(component c, size_t *n)
{
    (void)c;
    *n = 0;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SetContinuousStates(component c, const double x[], size_t n);
EXPORTED fmi3Status fmi3SetContinuousStates(component c, const double x[], size_t n)
{
    (void)x;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3SetContinuousStates: there are no continuous states and events");
}

EXPORTED fmi3Status fmi3GetContinuousStates(component c, double x[], size_t n);
EXPORTED fmi3Status fmi3GetContinuousStates(component c, double x[], size_t n)
{
    (void)x;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetContinuousStates: there are no continuous states and events");
}

EXPORTED fmi3Status fmi3GetContinuousStateDerivatives(component c, double x[], size_t n);
EXPORTED fmi3Status fmi3GetContinuousStateDerivatives(component c, double x[], size_t n)
{
    (void)x;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetContinuousStateDerivatives: there are no continuous states and events");
}

EXPORTED fmi3Status fmi3GetEventIndicators(component c, double x[], size_t n);
EXPORTED fmi3Status fmi3GetEventIndicators(component c, double x[], size_t n)
{
    (void)x;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetEventIndicators: there are no continuous states and events");
}

EXPORTED fmi3Status fmi3GetNominalsOfContinuousStates(component c, double x[], size_t n);
EXPORTED fmi3Status fmi3GetNominalsOfContinuousStates(component c, double x[], size_t n)
{
    (void)x;
    return (n == 0) ? fmi3OK : fail((instance *)c, "fmi3GetNominalsOfContinuousStates: there are no continuous states and events");
}
