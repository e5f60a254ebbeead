/* FMI 2.0 of an exported function: co-simulation, and model exchange of a function without memory. */

#include "core.h"

typedef void *component;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef unsigned int fmi2ValueReference;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;

typedef struct {
    void (*logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, fmi2Status);
    void *environment;
} fmi2CallbackFunctions;

typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

typedef struct {
    instance_data data;
    const fmi2CallbackFunctions *callbacks;
    char *name;
} instance;

/* a stored state begins with it, so that bytes of another FMU are refused */
static const char token[] = TOKEN;

/* logs a message, which is a format without conversions, and returns the status of an error */
static fmi2Status fail(const instance *q, const char *message)
{
    if ((q->callbacks != NULL) && (q->callbacks->logger != NULL)) {
        q->callbacks->logger(q->callbacks->environment, q->name, fmi2Error, "logStatusError", message);
    }
    return fmi2Error;
}

EXPORTED const char *fmi2GetTypesPlatform(void);
EXPORTED const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORTED const char *fmi2GetVersion(void);
EXPORTED const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORTED component fmi2Instantiate(fmi2String name, int kind, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging);
EXPORTED component fmi2Instantiate(fmi2String name, int kind, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    const char *own = (name != NULL) ? name : "";
    const size_t length = strlen(own) + 1;
    instance *q = (instance *)calloc(1, sizeof(instance));

    (void)resources;
    (void)visible;
    (void)logging;
    if (q == NULL) {
        return NULL;
    }
    q->callbacks = callbacks;
    q->name = (char *)malloc(length);
    if (q->name == NULL) {
        free(q);
        return NULL;
    }
    memcpy(q->name, own, length);
    if ((guid == NULL) || (strcmp(guid, TOKEN) != 0)) {
        (void)fail(q, "the GUID is not " TOKEN " of this FMU");
    } else if ((kind == 0) && (HAS_MEMORY != 0)) {
        (void)fail(q, "a function with memory is for co-simulation only");
    } else {
        reset_data(&q->data);
        return q;
    }
    free(q->name);
    free(q);
    return NULL;
}

EXPORTED void fmi2FreeInstance(component c);
EXPORTED void fmi2FreeInstance(component c)
{
    if (c != NULL) {
        free(((instance *)c)->name);
        free(c);
    }
}

EXPORTED fmi2Status fmi2SetDebugLogging(component c, fmi2Boolean on, size_t count, const fmi2String categories[]);
EXPORTED fmi2Status fmi2SetDebugLogging(component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)c;
    (void)on;
    (void)count;
    (void)categories;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SetupExperiment(component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean ends, fmi2Real stop);
EXPORTED fmi2Status fmi2SetupExperiment(component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean ends, fmi2Real stop)
{
    instance *q = (instance *)c;

    (void)tolerant;
    (void)tolerance;
    (void)ends;
    (void)stop;
    if (q->data.now != PHASE_CREATED) {
        return fail(q, "fmi2SetupExperiment: only before the initialization");
    }
    q->data.start = start;
    q->data.time = start;
    q->data.stale = 1;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2EnterInitializationMode(component c);
EXPORTED fmi2Status fmi2EnterInitializationMode(component c)
{
    instance *q = (instance *)c;

    if (q->data.now != PHASE_CREATED) {
        return fail(q, "fmi2EnterInitializationMode: only once, until fmi2Reset");
    }
    q->data.now = PHASE_INITIALIZING;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2ExitInitializationMode(component c);
EXPORTED fmi2Status fmi2ExitInitializationMode(component c)
{
    instance *q = (instance *)c;

    if (q->data.now != PHASE_INITIALIZING) {
        return fail(q, "fmi2ExitInitializationMode: only after fmi2EnterInitializationMode");
    }
    end_initialization(&q->data);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2Terminate(component c);
EXPORTED fmi2Status fmi2Terminate(component c)
{
    ((instance *)c)->data.now = PHASE_ENDED;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2Reset(component c);
EXPORTED fmi2Status fmi2Reset(component c)
{
    reset_data(&((instance *)c)->data);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetReal(component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]);
EXPORTED fmi2Status fmi2GetReal(component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    instance *q = (instance *)c;

    return (get_values(&q->data, r, n, v, n) != 0) ? fmi2OK : fail(q, "fmi2GetReal: unknown value reference");
}

EXPORTED fmi2Status fmi2SetReal(component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]);
EXPORTED fmi2Status fmi2SetReal(component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    instance *q = (instance *)c;

    return (set_values(&q->data, r, n, v, n) != 0) ? fmi2OK : fail(q, "fmi2SetReal: not an input or a parameter");
}

/* there are real variables only */
#define NO_VARIABLES(NAME, TYPE, CONSTANT)                                                                            \
    EXPORTED fmi2Status NAME(component c, const fmi2ValueReference r[], size_t n, CONSTANT TYPE v[]);                 \
    EXPORTED fmi2Status NAME(component c, const fmi2ValueReference r[], size_t n, CONSTANT TYPE v[])                  \
    {                                                                                                                  \
        (void)r;                                                                                                       \
        (void)v;                                                                                                       \
        return (n == 0) ? fmi2OK : fail((instance *)c, #NAME ": the FMU has real variables only");                     \
    }

NO_VARIABLES(fmi2GetInteger, fmi2Integer, )
NO_VARIABLES(fmi2SetInteger, fmi2Integer, const)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean, )
NO_VARIABLES(fmi2SetBoolean, fmi2Boolean, const)
NO_VARIABLES(fmi2GetString, fmi2String, )
NO_VARIABLES(fmi2SetString, fmi2String, const)

EXPORTED fmi2Status fmi2GetFMUstate(component c, void **state);
EXPORTED fmi2Status fmi2GetFMUstate(component c, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(instance_data));
    }
    if (*state == NULL) {
        return fail((instance *)c, "fmi2GetFMUstate: not enough memory");
    }
    memcpy(*state, &((instance *)c)->data, sizeof(instance_data));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SetFMUstate(component c, void *state);
EXPORTED fmi2Status fmi2SetFMUstate(component c, void *state)
{
    if (state == NULL) {
        return fail((instance *)c, "fmi2SetFMUstate: there is no state");
    }
    memcpy(&((instance *)c)->data, state, sizeof(instance_data));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2FreeFMUstate(component c, void **state);
EXPORTED fmi2Status fmi2FreeFMUstate(component c, void **state)
{
    (void)c;
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializedFMUstateSize(component c, void *state, size_t *size);
EXPORTED fmi2Status fmi2SerializedFMUstateSize(component c, void *state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(token) + sizeof(instance_data);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializeFMUstate(component c, void *state, char bytes[], size_t size);
EXPORTED fmi2Status fmi2SerializeFMUstate(component c, void *state, char bytes[], size_t size)
{
    if ((state == NULL) || (size < (sizeof(token) + sizeof(instance_data)))) {
        return fail((instance *)c, "fmi2SerializeFMUstate: there is no state, or too little room");
    }
    memcpy(bytes, token, sizeof(token));
    memcpy(&bytes[sizeof(token)], state, sizeof(instance_data));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2DeSerializeFMUstate(component c, const char bytes[], size_t size, void **state);
EXPORTED fmi2Status fmi2DeSerializeFMUstate(component c, const char bytes[], size_t size, void **state)
{
    if ((size != (sizeof(token) + sizeof(instance_data))) || (memcmp(bytes, token, sizeof(token)) != 0)) {
        return fail((instance *)c, "fmi2DeSerializeFMUstate: not a state of this FMU");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(instance_data));
    }
    if (*state == NULL) {
        return fail((instance *)c, "fmi2DeSerializeFMUstate: not enough memory");
    }
    memcpy(*state, &bytes[sizeof(token)], sizeof(instance_data));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetDirectionalDerivative(component c, const fmi2ValueReference unknowns[], size_t unknown_count,
    const fmi2ValueReference knowns[], size_t known_count, const fmi2Real seed[], fmi2Real sensitivity[]);
EXPORTED fmi2Status fmi2GetDirectionalDerivative(component c, const fmi2ValueReference unknowns[], size_t unknown_count,
    const fmi2ValueReference knowns[], size_t known_count, const fmi2Real seed[], fmi2Real sensitivity[])
{
    instance *q = (instance *)c;
    const int32_t done = get_derivative(
        &q->data, unknowns, unknown_count, knowns, known_count, seed, known_count, sensitivity, unknown_count);

    return (done != 0) ? fmi2OK : fail(q, "fmi2GetDirectionalDerivative: of outputs by inputs and parameters only");
}

EXPORTED fmi2Status fmi2DoStep(component c, fmi2Real time, fmi2Real step, fmi2Boolean keeps);
EXPORTED fmi2Status fmi2DoStep(component c, fmi2Real time, fmi2Real step, fmi2Boolean keeps)
{
    instance *q = (instance *)c;

    (void)keeps;
    if (q->data.now != PHASE_RUNNING) {
        return fail(q, "fmi2DoStep: only after the initialization");
    }
    if (is_allowed(step) == 0) {
        return fail(q, "fmi2DoStep: " STEP_RULE);
    }
    do_step(&q->data, time, step);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2CancelStep(component c);
EXPORTED fmi2Status fmi2CancelStep(component c)
{
    return fail((instance *)c, "fmi2CancelStep: no step is pending");
}

EXPORTED fmi2Status fmi2SetRealInputDerivatives(component c, const fmi2ValueReference r[], size_t n,
    const fmi2Integer order[], const fmi2Real v[]);
EXPORTED fmi2Status fmi2SetRealInputDerivatives(component c, const fmi2ValueReference r[], size_t n,
    const fmi2Integer order[], const fmi2Real v[])
{
    (void)r;
    (void)order;
    (void)v;
    return (n == 0) ? fmi2OK : fail((instance *)c, "fmi2SetRealInputDerivatives: inputs are not interpolated");
}

EXPORTED fmi2Status fmi2GetRealOutputDerivatives(component c, const fmi2ValueReference r[], size_t n,
    const fmi2Integer order[], fmi2Real v[]);
EXPORTED fmi2Status fmi2GetRealOutputDerivatives(component c, const fmi2ValueReference r[], size_t n,
    const fmi2Integer order[], fmi2Real v[])
{
    (void)r;
    (void)order;
    (void)v;
    return (n == 0) ? fmi2OK : fail((instance *)c, "fmi2GetRealOutputDerivatives: outputs have no derivatives in time");
}

#define NO_STATUS(NAME, TYPE)                                                                                          \
    EXPORTED fmi2Status NAME(component c, int kind, TYPE *value);                                                      \
    EXPORTED fmi2Status NAME(component c, int kind, TYPE *value)                                                       \
    {                                                                                                                  \
        (void)c;                                                                                                       \
        (void)kind;                                                                                                    \
        (void)value;                                                                                                   \
        return fmi2Discard;                                                                                            \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetRealStatus, fmi2Real)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_STATUS(fmi2GetStringStatus, fmi2String)

#if !HAS_MEMORY
/* model exchange without continuous states and events */

EXPORTED fmi2Status fmi2SetTime(component c, fmi2Real time);
EXPORTED fmi2Status fmi2SetTime(component c, fmi2Real time)
{
    ((instance *)c)->data.time = time;
    ((instance *)c)->data.stale = 1;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2EnterEventMode(component c);
EXPORTED fmi2Status fmi2EnterEventMode(component c)
{
    (void)c;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2NewDiscreteStates(component c, fmi2EventInfo *info);
EXPORTED fmi2Status fmi2NewDiscreteStates(component c, fmi2EventInfo *info)
{
    (void)c;
    memset(info, 0, sizeof(*info));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2EnterContinuousTimeMode(component c);
EXPORTED fmi2Status fmi2EnterContinuousTimeMode(component c)
{
    (void)c;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2CompletedIntegratorStep(component c, fmi2Boolean keeps, fmi2Boolean *event, fmi2Boolean *stop);
EXPORTED fmi2Status fmi2CompletedIntegratorStep(component c, fmi2Boolean keeps, fmi2Boolean *event, fmi2Boolean *stop)
{
    (void)c;
    (void)keeps;
    *event = 0;
    *stop = 0;
    return fmi2OK;
}

#define NO_STATES(NAME, CONSTANT)                                                                                      \
    EXPORTED fmi2Status NAME(component c, CONSTANT fmi2Real x[], size_t n);                                            \
    EXPORTED fmi2Status NAME(component c, CONSTANT fmi2Real x[], size_t n)                                             \
    {                                                                                                                  \
        (void)x;                                                                                                       \
        return (n == 0) ? fmi2OK : fail((instance *)c, #NAME ": the FMU has no continuous states and no events");      \
    }

NO_STATES(fmi2SetContinuousStates, const)
NO_STATES(fmi2GetContinuousStates, )
NO_STATES(fmi2GetDerivatives, )
NO_STATES(fmi2GetEventIndicators, )
NO_STATES(fmi2GetNominalsOfContinuousStates, )
#endif
