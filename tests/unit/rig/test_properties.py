"""Properties: a rig written out loads back equal, and nothing that is read raises anything but UserError."""

from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_forceps.rig import Rig, UserError, dump_rig, load_rig, parse_rig
from hil_forceps.rig.catalogue import EFFECT_IDS, EFFECTS, Effect
from hil_forceps.rig.quantities import Quantity
from hil_forceps.rig.schema import rig_from_data
from hil_forceps.rig.sections import ALGORITHM_IDS, DriveLaw, Forceps, Limits, Motor, Noise

ROOT = Path(__file__).parents[3]
PAPER = (ROOT / "configs" / "paper.yaml").read_text(encoding="utf-8")


def numbers(quantity: Quantity) -> st.SearchStrategy[float]:
    return st.floats(quantity.low, quantity.high, exclude_min=quantity.open_low)


def parameters(quantity: Quantity) -> st.SearchStrategy[object]:
    """Everything that may be said of a parameter."""
    number = numbers(quantity)
    bounds = st.tuples(number, number, number).map(sorted).filter(lambda three: three[0] < three[2])
    return st.one_of(
        st.just("unknown"),
        number,
        st.builds(lambda value, sd: {"value": value, "sd": sd}, number, st.floats(0.0, 1e300)),
        bounds.map(lambda three: {"min": three[0], "max": three[2]}),
        bounds.map(lambda three: {"min": three[0], "value": three[1], "max": three[2]}),
        st.builds(
            lambda three, sd: {"min": three[0], "value": three[1], "max": three[2], "sd": sd},
            bounds,
            st.floats(0.0, 1e300),
        ),
    )


def quantity_of(model: type[Forceps | Motor | DriveLaw | Noise | Limits], key: str) -> Quantity:
    field = model.model_fields[key]
    optional = (item for each in get_args(field.annotation) for item in get_args(each))  # of `X | None`
    parts = [*field.metadata, *optional]
    return next(item for item in parts if isinstance(item, Quantity))


def physical(model: type[Forceps | Motor]) -> st.SearchStrategy[dict[str, object]]:
    return st.fixed_dictionaries({key: parameters(quantity_of(model, key)) for key in model.model_fields})


def settings(model: type[DriveLaw | Noise | Limits], *required: str) -> st.SearchStrategy[dict[str, float]]:
    keys = {key: numbers(quantity_of(model, key)) for key in model.model_fields}
    return st.fixed_dictionaries(
        {key: keys.pop(key) for key in required},
        optional=keys,
    )


def effects() -> st.SearchStrategy[dict[str, dict[str, float]]]:
    def values(entry: Effect) -> st.SearchStrategy[dict[str, float]]:
        numbers_of = {item.name: st.floats(item.minimum, item.maximum) for item in entry.parameters}
        shapes = {item.name: numbers_of.pop(item.name) for item in entry.parameters if item.neutral is None}
        return st.fixed_dictionaries(shapes, optional=numbers_of)

    return st.fixed_dictionaries({}, optional={entry.id: values(entry) for entry in EFFECTS})


BENCH = st.fixed_dictionaries(
    {},
    optional={
        "transport": st.sampled_from(("classic", "fd")),
        "node_id": st.integers(1, 30),
        "drive_clock_ppm": st.floats(-20_000, 20_000),
        "latency_s": st.floats(0.0, 1.0),
        "algorithms": st.lists(st.sampled_from(ALGORITHM_IDS), min_size=1, unique=True),
        "simulations": st.lists(st.sampled_from((1, 2)), min_size=1, unique=True),
        "direct_sample_times_s": st.lists(st.floats(1e-6, 0.1), unique=True, max_size=3),
    },
)
RIGS = st.fixed_dictionaries(
    {
        "forceps": physical(Forceps),
        "motor": physical(Motor),
        "encoder": st.fixed_dictionaries({"counts_per_rev": st.just("ideal") | st.integers(4, 1 << 24)}),
    },
    optional={
        "drive": settings(DriveLaw, *DriveLaw.model_fields).filter(
            lambda given: given["cascade_time_s"] == 0.0 or given["kd_A_s_per_rad"] > 0.0
        ),
        "noise": settings(Noise),
        "limits": settings(Limits).filter(
            lambda given: given.get("position_min_rad", -3.0) < given.get("position_max_rad", 3.0)
        ),
        "effects": effects(),
        "bench": BENCH,
    },
)


@given(RIGS)
def test_what_is_written_loads_back_equal(data: dict[str, object]) -> None:
    rig = rig_from_data(data)
    if "bench" in data:
        # Read from a file, a bench section must also fit the rest; here it need not.
        assert rig_from_data(rig.to_data()) == rig
        rig = rig.with_changes({"bench": None})
    again = parse_rig(dump_rig(rig))
    assert again == rig
    assert hash(again) == hash(rig)
    assert dump_rig(again) == dump_rig(rig)


def assert_read_or_refused(text: str) -> None:
    try:
        parse_rig(text, "f")
    except UserError as error:
        lines = error.problems
    else:
        return
    assert lines
    for line in lines:
        assert line.startswith("f:")
        assert "\n" not in line
        line.encode()


@given(st.text(max_size=200))
def test_any_text_is_refused_in_words(text: str) -> None:
    assert_read_or_refused(text)


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_in_words(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("any") / "rig.yaml"
    path.write_bytes(content)
    with pytest.raises(UserError):
        load_rig(path)


@given(st.integers(0, len(PAPER)), st.integers(0, 40), st.text(max_size=12))
def test_a_mutilated_rig_is_read_or_refused_in_words(start: int, length: int, put: str) -> None:
    assert_read_or_refused(PAPER[:start] + put + PAPER[start + length :])


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@given(st.data())
def test_junk_at_any_key_is_taken_or_refused_in_words(data: st.DataObject) -> None:
    rig = parse_rig(PAPER)
    sections = list(Rig.model_fields)
    section = data.draw(st.sampled_from(sections))
    value = getattr(rig, section)
    keys = list(type(value).model_fields) if hasattr(type(value), "model_fields") else list(EFFECT_IDS)
    key = data.draw(st.sampled_from([section, *(f"{section}.{key}" for key in keys)]))
    junk = data.draw(JUNK)
    lines: tuple[str, ...] = ()
    try:
        rig.with_changes({key: junk})
    except UserError as error:
        lines = error.problems
    assert all(line and "\n" not in line for line in lines)
