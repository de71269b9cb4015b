/* What FMI 3.0 has and these units don't offer: every function of the standard must be there, and these answer with
   an error. */
#ifndef HF_FMI3_NOT_OFFERED_H
#define HF_FMI3_NOT_OFFERED_H

#define NOT_OFFERED_0(name) \
    fmi3Status name(fmi3Instance it) { \
        return not_offered(it); \
    }
#define NOT_OFFERED_1(name, T0) \
    fmi3Status name(fmi3Instance it, T0 a0) { \
        (void)a0; \
        return not_offered(it); \
    }
#define NOT_OFFERED_2(name, T0, T1) \
    fmi3Status name(fmi3Instance it, T0 a0, T1 a1) { \
        (void)a0; (void)a1; \
        return not_offered(it); \
    }
#define NOT_OFFERED_3(name, T0, T1, T2) \
    fmi3Status name(fmi3Instance it, T0 a0, T1 a1, T2 a2) { \
        (void)a0; (void)a1; (void)a2; \
        return not_offered(it); \
    }
#define NOT_OFFERED_4(name, T0, T1, T2, T3) \
    fmi3Status name(fmi3Instance it, T0 a0, T1 a1, T2 a2, T3 a3) { \
        (void)a0; (void)a1; (void)a2; (void)a3; \
        return not_offered(it); \
    }
#define NOT_OFFERED_5(name, T0, T1, T2, T3, T4) \
    fmi3Status name(fmi3Instance it, T0 a0, T1 a1, T2 a2, T3 a3, T4 a4) { \
        (void)a0; (void)a1; (void)a2; (void)a3; (void)a4; \
        return not_offered(it); \
    }
#define NOT_OFFERED_6(name, T0, T1, T2, T3, T4, T5) \
    fmi3Status name(fmi3Instance it, T0 a0, T1 a1, T2 a2, T3 a3, T4 a4, T5 a5) { \
        (void)a0; (void)a1; (void)a2; (void)a3; (void)a4; (void)a5; \
        return not_offered(it); \
    }
#define NOT_OFFERED_8(name, T0, T1, T2, T3, T4, T5, T6, T7) \
    fmi3Status name(fmi3Instance it, T0 a0, T1 a1, T2 a2, T3 a3, T4 a4, T5 a5, T6 a6, T7 a7) { \
        (void)a0; (void)a1; (void)a2; (void)a3; (void)a4; (void)a5; (void)a6; (void)a7; \
        return not_offered(it); \
    }

NOT_OFFERED_0(fmi3EnterEventMode)
NOT_OFFERED_4(fmi3GetFloat32, const fmi3ValueReference *, size_t, fmi3Float32 *, size_t)
NOT_OFFERED_4(fmi3GetInt8, const fmi3ValueReference *, size_t, fmi3Int8 *, size_t)
NOT_OFFERED_4(fmi3GetUInt8, const fmi3ValueReference *, size_t, fmi3UInt8 *, size_t)
NOT_OFFERED_4(fmi3GetInt16, const fmi3ValueReference *, size_t, fmi3Int16 *, size_t)
NOT_OFFERED_4(fmi3GetUInt16, const fmi3ValueReference *, size_t, fmi3UInt16 *, size_t)
NOT_OFFERED_4(fmi3GetUInt32, const fmi3ValueReference *, size_t, fmi3UInt32 *, size_t)
NOT_OFFERED_4(fmi3GetInt64, const fmi3ValueReference *, size_t, fmi3Int64 *, size_t)
NOT_OFFERED_4(fmi3GetUInt64, const fmi3ValueReference *, size_t, fmi3UInt64 *, size_t)
NOT_OFFERED_4(fmi3GetString, const fmi3ValueReference *, size_t, fmi3String *, size_t)
NOT_OFFERED_5(fmi3GetBinary, const fmi3ValueReference *, size_t, size_t *, fmi3Binary *, size_t)
NOT_OFFERED_3(fmi3GetClock, const fmi3ValueReference *, size_t, fmi3Clock *)
NOT_OFFERED_4(fmi3SetFloat32, const fmi3ValueReference *, size_t, const fmi3Float32 *, size_t)
NOT_OFFERED_4(fmi3SetInt8, const fmi3ValueReference *, size_t, const fmi3Int8 *, size_t)
NOT_OFFERED_4(fmi3SetUInt8, const fmi3ValueReference *, size_t, const fmi3UInt8 *, size_t)
NOT_OFFERED_4(fmi3SetInt16, const fmi3ValueReference *, size_t, const fmi3Int16 *, size_t)
NOT_OFFERED_4(fmi3SetUInt16, const fmi3ValueReference *, size_t, const fmi3UInt16 *, size_t)
NOT_OFFERED_4(fmi3SetUInt32, const fmi3ValueReference *, size_t, const fmi3UInt32 *, size_t)
NOT_OFFERED_4(fmi3SetInt64, const fmi3ValueReference *, size_t, const fmi3Int64 *, size_t)
NOT_OFFERED_4(fmi3SetUInt64, const fmi3ValueReference *, size_t, const fmi3UInt64 *, size_t)
NOT_OFFERED_4(fmi3SetString, const fmi3ValueReference *, size_t, const fmi3String *, size_t)
NOT_OFFERED_5(fmi3SetBinary, const fmi3ValueReference *, size_t, const size_t *, const fmi3Binary *, size_t)
NOT_OFFERED_3(fmi3SetClock, const fmi3ValueReference *, size_t, const fmi3Clock *)
NOT_OFFERED_2(fmi3GetNumberOfVariableDependencies, fmi3ValueReference, size_t*)
NOT_OFFERED_6(fmi3GetVariableDependencies, fmi3ValueReference, size_t *, fmi3ValueReference *, size_t *,
              fmi3DependencyKind *, size_t)
NOT_OFFERED_8(fmi3GetDirectionalDerivative, const fmi3ValueReference *, size_t, const fmi3ValueReference *, size_t,
              const fmi3Float64 *, size_t, fmi3Float64 *, size_t)
NOT_OFFERED_8(fmi3GetAdjointDerivative, const fmi3ValueReference *, size_t, const fmi3ValueReference *, size_t, const
              fmi3Float64 *, size_t, fmi3Float64 *, size_t)
NOT_OFFERED_0(fmi3EnterConfigurationMode)
NOT_OFFERED_0(fmi3ExitConfigurationMode)
NOT_OFFERED_4(fmi3GetIntervalDecimal, const fmi3ValueReference *, size_t, fmi3Float64 *, fmi3IntervalQualifier *)
NOT_OFFERED_5(fmi3GetIntervalFraction, const fmi3ValueReference *, size_t, fmi3UInt64 *, fmi3UInt64 *,
              fmi3IntervalQualifier *)
NOT_OFFERED_3(fmi3GetShiftDecimal, const fmi3ValueReference *, size_t, fmi3Float64 *)
NOT_OFFERED_4(fmi3GetShiftFraction, const fmi3ValueReference *, size_t, fmi3UInt64 *, fmi3UInt64 *)
NOT_OFFERED_3(fmi3SetIntervalDecimal, const fmi3ValueReference *, size_t, const fmi3Float64 *)
NOT_OFFERED_4(fmi3SetIntervalFraction, const fmi3ValueReference *, size_t, const fmi3UInt64 *, const fmi3UInt64 *)
NOT_OFFERED_3(fmi3SetShiftDecimal, const fmi3ValueReference *, size_t, const fmi3Float64 *)
NOT_OFFERED_4(fmi3SetShiftFraction, const fmi3ValueReference *, size_t, const fmi3UInt64 *, const fmi3UInt64 *)
NOT_OFFERED_0(fmi3EvaluateDiscreteStates)
NOT_OFFERED_6(fmi3UpdateDiscreteStates, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*, fmi3Boolean*,
              fmi3Float64*)
NOT_OFFERED_0(fmi3EnterContinuousTimeMode)
NOT_OFFERED_3(fmi3CompletedIntegratorStep, fmi3Boolean, fmi3Boolean*, fmi3Boolean*)
NOT_OFFERED_1(fmi3SetTime, fmi3Float64)
NOT_OFFERED_2(fmi3SetContinuousStates, const fmi3Float64 *, size_t)
NOT_OFFERED_2(fmi3GetContinuousStateDerivatives, fmi3Float64 *, size_t)
NOT_OFFERED_2(fmi3GetEventIndicators, fmi3Float64 *, size_t)
NOT_OFFERED_2(fmi3GetContinuousStates, fmi3Float64 *, size_t)
NOT_OFFERED_2(fmi3GetNominalsOfContinuousStates, fmi3Float64 *, size_t)
NOT_OFFERED_1(fmi3GetNumberOfEventIndicators, size_t*)
NOT_OFFERED_1(fmi3GetNumberOfContinuousStates, size_t*)
NOT_OFFERED_0(fmi3EnterStepMode)
NOT_OFFERED_5(fmi3GetOutputDerivatives, const fmi3ValueReference *, size_t, const fmi3Int32 *, fmi3Float64 *, size_t)
NOT_OFFERED_2(fmi3ActivateModelPartition, fmi3ValueReference, fmi3Float64)

#endif
