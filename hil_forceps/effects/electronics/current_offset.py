"""Current offset: offset of the current sensor."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "current_offset",
    "sensor",
    "offset of the current sensor",
    "i_meas = i + i0",
    (Parameter("offset_A", "A", -10.0, 10.0, 0.0, 5e-3, "i0"),),
    "sensor calibration",
    "the drive's law, or motion in both directions",
)
