/* Made by emps-design {{ version }}: {{ model }} of the axis "{{ axis }}" as an FMI 3.0 unit for co-simulation.
 *
 * A communication step is a whole number of samples of {{ period }} s. Inputs act from its beginning, outputs
 * belong to its end{{ note }}.
 */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
{{ code }}
#define PERIOD {{ period }}
#define SETTABLE {{ settable }} /* value references 1 to this one are inputs */

#if defined _WIN32
#define FMI __declspec(dllexport)
#elif defined __GNUC__
#define FMI __attribute__((visibility("default")))
#else
#define FMI
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } status;
typedef uint32_t reference;
typedef void (*log_message)(void *environment, status, const char *category, const char *message);

typedef struct {
    double value[VALUES];
    model state;
    double start; /* s */
    long long samples;
    bool started; /* the outputs are those of a run, which may have ended */
    bool running;
    void *environment;
    log_message log;
} instance;

static status failed(instance *i, const char *message)
{
    if (i->log != NULL) {
        i->log(i->environment, ERROR, "logStatusError", message);
    }
    return ERROR;
}

FMI const char *fmi3GetVersion(void)
{
    return "3.0";
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging,
    bool events, bool early, const reference *required, size_t count, void *environment, log_message log, void *update)
{
    instance *i = NULL;

    (void)name; (void)resources; (void)visible; (void)logging; (void)events; (void)early; (void)required; (void)count; (void)update;
    if (token != NULL && strcmp(token, "{{ token }}") == 0) {
        i = calloc(1, sizeof *i);
    }
    if (i != NULL) {
        memcpy(i->value, START, sizeof START);
        i->environment = environment;
        i->log = log;
    }
    return i;
}

FMI void fmi3FreeInstance(void *given)
{
    free(given);
}

FMI status fmi3EnterInitializationMode(void *given, bool tolerance_defined, double tolerance, double start, bool stop_defined, double stop)
{
    instance *i = given;

    (void)tolerance_defined; (void)tolerance; (void)stop_defined; (void)stop;
    i->start = start;
    i->samples = 0;
    i->value[TIME] = start;
    return OK;
}

FMI status fmi3ExitInitializationMode(void *given)
{
    instance *i = given;

    model_begin(&i->state, i->value);
    i->started = true;
    i->running = true;
    return OK;
}

FMI status fmi3Terminate(void *given)
{
    ((instance *)given)->running = false;
    return OK;
}

FMI status fmi3Reset(void *given)
{
    instance *i = given;

    memcpy(i->value, START, sizeof START);
    i->started = false;
    i->running = false;
    return OK;
}

FMI status fmi3GetFloat64(void *given, const reference *which, size_t count, double *value, size_t values)
{
    instance *i = given;

    if (!i->started) {
        model_begin(&i->state, i->value); /* in initialization mode: outputs of the start values */
    }
    for (size_t n = 0; n < count; n++) {
        if (which[n] >= VALUES || n >= values) {
            return failed(i, "found a value reference that is not there");
        }
        value[n] = i->value[which[n]];
    }
    return OK;
}

FMI status fmi3SetFloat64(void *given, const reference *which, size_t count, const double *value, size_t values)
{
    instance *i = given;

    for (size_t n = 0; n < count; n++) {
        if (which[n] == TIME || which[n] >= VALUES || n >= values || (which[n] > SETTABLE && which[n] != PARAMETER)) {
            return failed(i, "found a value reference that cannot be set, expected an input or a parameter");
        }
        if (which[n] == PARAMETER && i->running) {
            return failed(i, "found a parameter to set while running, expected it before");
        }
        if (!(value[n] - value[n] == 0.0)) {
            return failed(i, "found a value that is not finite");
        }
        i->value[which[n]] = value[n];
    }
    return OK;
}

FMI status fmi3DoStep(void *given, double now, double step, bool no_return, bool *event, bool *terminate, bool *early, double *last)
{
    instance *i = given;
    double count = (now + step - i->start) / PERIOD - (double)i->samples;
    long long samples = (long long)(count + 0.5);
    double off = count - (double)samples;

    (void)no_return;
    *event = *terminate = *early = false;
    *last = now;
    if (!i->running || samples < 0 || off > 1e-3 || off < -1e-3) {
        return failed(i, "found a step that is no whole number of samples, expected one of {{ period }} s or a multiple");
    }
    for (; samples > 0; samples--) {
        if (!model_step(&i->state, i->value)) {
            return failed(i, "the motion cannot be followed: it leaves every bound, or no step is short enough");
        }
        i->samples++;
        i->value[TIME] = i->start + (double)i->samples * PERIOD;
    }
    *last = now + step;
    return OK;
}

/* A saved state of an instance, for a master that steps back. It points into its owner and is valid for it only. */
typedef struct {
    instance *owner;
    instance content;
} saved;

FMI status fmi3GetFMUState(void *given, void **state)
{
    saved *copy = *state != NULL ? *state : malloc(sizeof *copy);

    if (copy == NULL) {
        return failed(given, "found no memory for a state");
    }
    copy->owner = given;
    copy->content = *copy->owner;
    *state = copy;
    return OK;
}

FMI status fmi3SetFMUState(void *given, void *state)
{
    const saved *copy = state;

    if (copy == NULL || copy->owner != given) {
        return failed(given, "found a state of another instance, expected one of this instance");
    }
    *copy->owner = copy->content;
    return OK;
}

FMI status fmi3FreeFMUState(void *given, void **state)
{
    (void)given;
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return OK;
}

FMI status fmi3SetDebugLogging(void *given, bool on, size_t count, const char *const categories[])
{
    (void)given; (void)on; (void)count; (void)categories;
    return OK;
}

/* Functions that this unit does not support. */
static status missing(void *given)
{
    return failed(given, "found a call that this unit does not have; modelDescription.xml says what it has");
}

FMI status fmi3EnterEventMode(void *given) { return missing(given); }
FMI status fmi3EnterStepMode(void *given) { return missing(given); }
FMI status fmi3EnterConfigurationMode(void *given) { return missing(given); }
FMI status fmi3ExitConfigurationMode(void *given) { return missing(given); }
FMI status fmi3EvaluateDiscreteStates(void *given) { return missing(given); }
FMI status fmi3UpdateDiscreteStates(void *given, bool *a, bool *b, bool *c, bool *d, bool *e, double *f) { (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; return missing(given); }
FMI status fmi3GetBinary(void *given, const reference *a, size_t b, size_t *c, const uint8_t **d, size_t e) { (void)a; (void)b; (void)c; (void)d; (void)e; return missing(given); }
FMI status fmi3SetBinary(void *given, const reference *a, size_t b, const size_t *c, const uint8_t *const *d, size_t e) { (void)a; (void)b; (void)c; (void)d; (void)e; return missing(given); }
FMI status fmi3GetClock(void *given, const reference *a, size_t b, bool *c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3SetClock(void *given, const reference *a, size_t b, const bool *c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3GetNumberOfVariableDependencies(void *given, reference a, size_t *b) { (void)a; (void)b; return missing(given); }
FMI status fmi3GetVariableDependencies(void *given, reference a, size_t *b, reference *c, size_t *d, int *e, size_t f) { (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; return missing(given); }
FMI status fmi3SerializedFMUStateSize(void *given, void *a, size_t *b) { (void)a; (void)b; return missing(given); }
FMI status fmi3SerializeFMUState(void *given, void *a, uint8_t *b, size_t c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3DeserializeFMUState(void *given, const uint8_t *a, size_t b, void **c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3GetDirectionalDerivative(void *given, const reference *a, size_t b, const reference *c, size_t d, const double *e, size_t f, double *g, size_t h) { (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; (void)g; (void)h; return missing(given); }
FMI status fmi3GetAdjointDerivative(void *given, const reference *a, size_t b, const reference *c, size_t d, const double *e, size_t f, double *g, size_t h) { (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; (void)g; (void)h; return missing(given); }
FMI status fmi3GetIntervalDecimal(void *given, const reference *a, size_t b, double *c, int *d) { (void)a; (void)b; (void)c; (void)d; return missing(given); }
FMI status fmi3GetIntervalFraction(void *given, const reference *a, size_t b, uint64_t *c, uint64_t *d, int *e) { (void)a; (void)b; (void)c; (void)d; (void)e; return missing(given); }
FMI status fmi3GetShiftDecimal(void *given, const reference *a, size_t b, double *c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3GetShiftFraction(void *given, const reference *a, size_t b, uint64_t *c, uint64_t *d) { (void)a; (void)b; (void)c; (void)d; return missing(given); }
FMI status fmi3SetIntervalDecimal(void *given, const reference *a, size_t b, const double *c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3SetIntervalFraction(void *given, const reference *a, size_t b, const uint64_t *c, const uint64_t *d) { (void)a; (void)b; (void)c; (void)d; return missing(given); }
FMI status fmi3SetShiftDecimal(void *given, const reference *a, size_t b, const double *c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3SetShiftFraction(void *given, const reference *a, size_t b, const uint64_t *c, const uint64_t *d) { (void)a; (void)b; (void)c; (void)d; return missing(given); }
FMI status fmi3GetOutputDerivatives(void *given, const reference *a, size_t b, const int32_t *c, double *d, size_t e) { (void)a; (void)b; (void)c; (void)d; (void)e; return missing(given); }
FMI status fmi3EnterContinuousTimeMode(void *given) { return missing(given); }
FMI status fmi3CompletedIntegratorStep(void *given, bool a, bool *b, bool *c) { (void)a; (void)b; (void)c; return missing(given); }
FMI status fmi3SetTime(void *given, double a) { (void)a; return missing(given); }
FMI status fmi3SetContinuousStates(void *given, const double *a, size_t b) { (void)a; (void)b; return missing(given); }
FMI status fmi3GetContinuousStateDerivatives(void *given, double *a, size_t b) { (void)a; (void)b; return missing(given); }
FMI status fmi3GetEventIndicators(void *given, double *a, size_t b) { (void)a; (void)b; return missing(given); }
FMI status fmi3GetContinuousStates(void *given, double *a, size_t b) { (void)a; (void)b; return missing(given); }
FMI status fmi3GetNominalsOfContinuousStates(void *given, double *a, size_t b) { (void)a; (void)b; return missing(given); }
FMI status fmi3GetNumberOfEventIndicators(void *given, size_t *a) { (void)a; return missing(given); }
FMI status fmi3GetNumberOfContinuousStates(void *given, size_t *a) { (void)a; return missing(given); }
FMI status fmi3ActivateModelPartition(void *given, reference a, double b) { (void)a; (void)b; return missing(given); }

FMI void *fmi3InstantiateModelExchange(const char *a, const char *b, const char *c, bool d, bool e, void *f, log_message g)
{
    (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; (void)g;
    return NULL;
}

FMI void *fmi3InstantiateScheduledExecution(const char *a, const char *b, const char *c, bool d, bool e, void *f, log_message g,
    void *h, void *i, void *j)
{
    (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; (void)g; (void)h; (void)i; (void)j;
    return NULL;
}

#define NO_TYPE(name, type) \
    FMI status fmi3Get##name(void *given, const reference *which, size_t count, type *value, size_t values) \
    { (void)which; (void)value; (void)values; return count == 0 ? OK : failed(given, "found a type that no variable has"); } \
    FMI status fmi3Set##name(void *given, const reference *which, size_t count, const type *value, size_t values) \
    { (void)which; (void)value; (void)values; return count == 0 ? OK : failed(given, "found a type that no variable has"); }

NO_TYPE(Float32, float)
NO_TYPE(Int8, int8_t)
NO_TYPE(UInt8, uint8_t)
NO_TYPE(Int16, int16_t)
NO_TYPE(UInt16, uint16_t)
NO_TYPE(Int32, int32_t)
NO_TYPE(UInt32, uint32_t)
NO_TYPE(Int64, int64_t)
NO_TYPE(UInt64, uint64_t)
NO_TYPE(Boolean, bool)
NO_TYPE(String, char *)
