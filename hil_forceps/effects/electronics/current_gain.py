"""Current gain: gain of the current sensor."""

from hil_forceps.effects.entry import Effect, Parameter

# Plausible: the gain of a sound sensor is off by a tenth at most.
EFFECT = Effect(
    "current_gain",
    "sensor",
    "gain of the current sensor",
    "i_meas = (1 + g) i",
    (Parameter("relative_error", "", -0.9, 2.0, 0.0, 0.02, "g", plausible=0.1),),
    "sensor calibration",
    "the drive's law; without it this can't be told from K_t",
)
