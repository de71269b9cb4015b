"""Without a load cell, what acts on the jaw is a load, as any: nothing at the jaw is named, and no curve acts there."""

from hil_forceps.diagnosis.identification import identify
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import curves_for
from hil_forceps.diagnosis.preparation.even_rows import EvenRun
from hil_forceps.rig.catalogue import effect
from hil_forceps.runs.table import Run
from tests.hidden_effects.generator import RIG
from tests.unit.diagnosis.runs_of_a_forceps import POOL, runs_of


def test_entries_and_curves_at_the_jaw_are_left_out() -> None:
    run = runs_of(RIG, ("short_hold",), 7600)[0]
    blind = Run(run.name, {key: values for key, values in run.columns.items() if key != "tau_w_N_m"})
    for runs, there in (([blind], False), ([run], True)):
        found = identify([EvenRun.whole(r) for r in runs], [], RIG, mapper=POOL.map).found
        looked_at = {effect(place.effect_id).location for place in found.steps[0].places}
        assert ("jaw" in looked_at) is there
        assert any(curve.place == "jaw" for curve in curves_for(found.best.fit.passes.runs)) is there
