"""Wire permanent stretch: the zero of the wire has moved."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "wire_permanent_stretch",
    "wire",
    "the zero of the wire has moved",
    "e = x − x0",
    (Parameter("stretch_m", "m", -5e-3, 5e-3, 0.0, 1e-6, "x0"),),
    "plastic stretch of a wire (constructional stretch): Costello 1997",
    "the jaw's angle against the motor's without load",
    changes="wire",
)
