/* A unit by FMI 2.0, co-simulation. All that it doesn't offer answers with an error. */
#include "fmi2Functions.h"

#include "instance.h"

#define UNUSED(x) (void)(x)
#define STATUS(fine) ((fine) ? fmi2OK : fmi2Error)

static void say(const Instance *it, const char *message) {
    fmi2CallbackLogger logger = (fmi2CallbackLogger)it->logger;
    if (logger != NULL) {
        logger(it->environment, it->name, fmi2Error, "logStatusError", "%s", message);
    }
}

static fmi2Status not_offered(fmi2Component c) {
    hf_fail(c, "this function is not offered");
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    UNUSED(resources);
    UNUSED(visible);
    Instance *it = type == fmi2CoSimulation && functions != NULL
                       ? hf_new(name, guid, functions->componentEnvironment, true)
                       : NULL;
    UNUSED(logging); /* errors are told always */
    if (it != NULL) {
        it->logger = (void (*)(void))functions->logger;
        it->say = say;
    } else if (functions != NULL && functions->logger != NULL) {
        functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError", "%s",
                          "co-simulation only, with the GUID of the model description");
    }
    return it;
}

void fmi2FreeInstance(fmi2Component c) { hf_free(c); }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    UNUSED(c), UNUSED(on), UNUSED(n), UNUSED(categories);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    UNUSED(has_tolerance), UNUSED(tolerance), UNUSED(has_stop), UNUSED(stop);
    ((Instance *)c)->now.time_s = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return STATUS(hf_enter(c, ((Instance *)c)->now.time_s));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return STATUS(hf_exit(c)); }

fmi2Status fmi2Terminate(fmi2Component c) {
    ((Instance *)c)->now.phase = HF_ENDED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    hf_reset(c);
    return fmi2OK;
}

#define GETTER(Name, Type, kind)                                                                           \
    fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, Type value[]) {     \
        for (size_t i = 0; i < n; i++) {                                                                   \
            double found = 0.0;                                                                            \
            if (!hf_get(c, vr[i], kind, &found)) {                                                         \
                return fmi2Error;                                                                          \
            }                                                                                              \
            value[i] = (Type)found;                                                                        \
        }                                                                                                  \
        return fmi2OK;                                                                                     \
    }
#define SETTER(Name, Type, kind)                                                                           \
    fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n, const Type value[]) { \
        for (size_t i = 0; i < n; i++) {                                                                   \
            if (!hf_set(c, vr[i], kind, (double)value[i])) {                                               \
                return fmi2Error;                                                                          \
            }                                                                                              \
        }                                                                                                  \
        return fmi2OK;                                                                                     \
    }

GETTER(Real, fmi2Real, 'r')
GETTER(Integer, fmi2Integer, 'i')
GETTER(Boolean, fmi2Boolean, 'b')
SETTER(Real, fmi2Real, 'r')
SETTER(Integer, fmi2Integer, 'i')
SETTER(Boolean, fmi2Boolean, 'b')

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    UNUSED(vr), UNUSED(value);
    return n == 0 ? fmi2OK : not_offered(c);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    UNUSED(vr), UNUSED(value);
    return n == 0 ? fmi2OK : not_offered(c);
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return STATUS(hf_save(c, state)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return STATUS(hf_restore(c, state)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    UNUSED(c);
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    UNUSED(c), UNUSED(state);
    *size = sizeof(Saved);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    return STATUS(hf_serialize(c, state, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    return STATUS(hf_deserialize(c, bytes, size, state));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t m, const fmi2Real by[],
                                        fmi2Real result[]) {
    UNUSED(unknown), UNUSED(n), UNUSED(known), UNUSED(m), UNUSED(by), UNUSED(result);
    return not_offered(c);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    UNUSED(vr), UNUSED(n), UNUSED(order), UNUSED(value);
    return not_offered(c);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    UNUSED(vr), UNUSED(n), UNUSED(order), UNUSED(value);
    return not_offered(c);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real start, fmi2Real step, fmi2Boolean no_set_before) {
    UNUSED(no_set_before);
    return STATUS(hf_step(c, start, step));
}

fmi2Status fmi2CancelStep(fmi2Component c) { return not_offered(c); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    UNUSED(kind), UNUSED(value);
    return not_offered(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) {
        return not_offered(c);
    }
    *value = ((Instance *)c)->now.time_s;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    UNUSED(kind), UNUSED(value);
    return not_offered(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) {
        return not_offered(c);
    }
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    UNUSED(kind), UNUSED(value);
    return not_offered(c);
}
