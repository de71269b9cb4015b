"""A diagnosis as plain text: the verdict, the effects with their parameters, and the gain."""

from collections.abc import Iterator

from hil_forceps.diagnosis.result import Diagnosis, Estimate, Rung


def text_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the lines for a terminal, the verdict first."""
    return [
        f"{diagnosis.verdict}: {diagnosis.sentence}",
        *_causes(diagnosis),
        *_gains(diagnosis),
        *(f"  ladder, {rung.id or 'known parameters'}: {_rung(rung)}" for rung in diagnosis.ladder),
        *(f"  data, {f.run or 'all runs'}: {f.text}" for f in diagnosis.data_audit if f.severity != "note"),
        *(f"  reason: {reason}" for reason in diagnosis.reasons),
        *_what_next(diagnosis),
    ]


def _causes(diagnosis: Diagnosis) -> Iterator[str]:
    for effect in diagnosis.effects:
        values = ", ".join(
            f"{name} = {p.value:.4g} {p.unit} [{p.low:.4g}, {p.high:.4g}]".replace("  ", " ")
            for name, p in effect.parameters.items()
        )
        yield f"  {effect.id} ({effect.location}), confidence {effect.confidence:.2f}: {values}"
    if len(diagnosis.candidate_sets) > 1:
        yield "  equally good: " + "; ".join(" + ".join(ids) for ids in diagnosis.candidate_sets[1:])
    for name, shift in diagnosis.parameter_shifts.items():
        assumed = "unknown" if shift.assumed is None else f"{shift.assumed:.4g}"
        yield f"  {name}: {assumed} -> {_interval(shift.fitted)} {shift.fitted.unit}"


def _interval(fitted: Estimate) -> str:
    return f"{fitted.value:.4g} [{fitted.low:.4g}, {fitted.high:.4g}]"


def _gains(diagnosis: Diagnosis) -> Iterator[str]:
    for name, gain in diagnosis.gain.items():
        yield (
            f"  held out, {name}: RMSE {gain.baseline_rmse:.4g} -> {gain.extended_rmse:.4g} "
            f"(noise {gain.floor_rmse:.4g}), explained {100 * gain.explained_share:.0f} % "
            f"[{100 * gain.low:.0f}, {100 * gain.high:.0f}]"
        )


def _rung(rung: Rung) -> str:
    errors = ", ".join(f"{name} {error:.4g}{_gain_of(rung, name)}" for name, error in rung.rmse.items())
    values = (f"; {name} = {_interval(p)} {p.unit}".rstrip() for name, p in rung.parameters.items())
    return errors + "".join(values)


def _gain_of(rung: Rung, channel: str) -> str:
    return f" (gains {100 * rung.gain[channel]:.0f} %)" if channel in rung.gain else ""


def _what_next(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.varies_over:
        yield f"  the remaining residual varies over {', '.join(diagnosis.varies_over)}"
    if (following := diagnosis.next_experiment) is not None:
        yield f"  next: {following.name} (separation {following.predicted_separation:.1f} sd); {following.why}"
