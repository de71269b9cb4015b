"""`hil-forceps init`: every motor with every drive gives a rig that loads and in which `check` finds no problem."""

import io
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator

from hil_forceps.cli import main as cli
from hil_forceps.cli.arguments import questions
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import load_rig, presets
from hil_forceps.rig.json_schema import schema
from hil_forceps.rig.units import factor
from hil_forceps.rig.yaml_loader import load_document

Call = Callable[..., tuple[int, str, str]]
PULLEYS = ("--motor-pulley-radius-mm", "10", "--jaw-pulley-radius-mm", "2")
FORCEPS = ("--motor-pulley-radius-mm", "2", "--jaw-pulley-radius-mm", "1.4")
PAIRS = [(motor, drive) for motor in presets.motors() for drive in presets.drives()]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run a command in this process, in an empty folder, with nobody at the terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO())

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(list(arguments))
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return run


def needed(motor: str) -> list[str]:
    """Return the options that the motor's preset leaves open."""
    values = presets.motor_preset(motor).values
    counts = [] if values.encoder_counts_per_rev else ["--encoder-counts", "16384"]
    return counts + ([] if values.nominal_current_A else ["--current-limit", "0.5"])


@pytest.mark.parametrize("more", [(), ("--assume",), ("--gear", "-3", "--assume", "--tension-max", "40")], ids=" ".join)
@pytest.mark.parametrize(("motor", "drive"), PAIRS, ids=["-".join(pair) for pair in PAIRS])
def test_every_motor_goes_with_every_drive(call: Call, motor: str, drive: str, more: tuple[str, ...]) -> None:
    own = presets.motor_preset(motor).drive
    if own is not None and "--gear" in more:
        more = more[2:]  # an actuator has its gear inside; with another its gains are finer than a mit's fields
    code, out, err = call("init", "r.yaml", "--motor", motor, "--drive", drive, *needed(motor), *PULLEYS, *more)
    if own not in {None, drive}:
        assert (code, out) == (2, "")
        assert err.startswith(f"hil-forceps: --drive {drive}: ")
        assert f"use --drive {own}" in err
        assert not Path("r.yaml").exists()
        return
    assert code == 0, err
    rig = load_rig("r.yaml")
    assert rig.drive_profile == drive
    machine_for(rig)
    assert [each for each in findings(rig) if each.level == "problem"] == []
    data = load_document(Path("r.yaml").read_text(), "r").data
    assert list(Draft7Validator(schema("rig")).iter_errors(data)) == []
    if more:
        rig.require_bench()  # all has a value
    else:
        assert call("check", "r.yaml")[0] == 0


def test_a_written_rig_has_a_comment_for_each_key_and_finds_its_schema(call: Call) -> None:
    call("init", "r.yaml", "--motor", "maxon-ec13-305194", "--drive", "odrive", "--encoder-counts", "4096", *PULLEYS)
    lines = Path("r.yaml").read_text().splitlines()
    keys = [place for place, line in enumerate(lines) if re.match(r" *[A-Za-z_0-9]+:", line)]
    assert len(keys) > 30
    assert all(lines[place - 1].lstrip().startswith("# ") for place in keys)
    assert max(map(len, lines)) <= 120
    found = re.fullmatch(r"# yaml-language-server: \$schema=(.*)", lines[0])
    assert found
    assert json.loads(Path(found[1]).read_text()) == schema("rig")
    assert "0.00803" in "\n".join(lines)
    assert "line 12, 8.03 mNm/A" in "\n".join(lines)


def test_nothing_is_written_over_without_being_told(call: Call) -> None:
    Path("r.yaml").write_text("mine")
    line = ("init", "r.yaml", "--motor", "paper", "--drive", "native", *needed("paper"), *FORCEPS)
    code, out, err = call(*line)
    assert (code, out, err) == (2, "", "hil-forceps: r.yaml: already exists; name another file, or use --overwrite\n")
    assert Path("r.yaml").read_text() == "mine"
    assert call(*line, "--overwrite")[0] == 0
    load_rig("r.yaml")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "--motor NAME, --drive NAME, --motor-pulley-radius-mm R, --jaw-pulley-radius-mm R, --encoder-counts N"),
        ("--motor paper --drive native --motor-pulley-radius-mm 2", "missing options: --jaw-pulley-radius-mm R"),
        (
            "--motor maxon-ec13 --drive native",
            "--motor maxon-ec13: there is no such preset; did you mean maxon-ec13-30519",
        ),
        ("--motor own --drive native", "missing options: --torque-constant"),
        ("--motor paper --drive odrve", "did you mean odrive?"),
        ("--motor paper --drive native --gear 0", "0.0: must be"),
        ("--motor paper --drive native --motor-pulley-radius-mm -2", "must be above 0, the radius in mm"),
        ("--motor paper --drive native --motor-pulley-radius-mm 2000", "must be at most 200"),
        ("--motor paper --drive native --encoder-counts 3", "must be a whole number of counts, 4 to"),
        ("--motor paper --drive native --jaw-min-deg 90 --jaw-max-deg 0", "--jaw-min-deg 90: must be below"),
        ("--motor paper --drive native --tension-max nan", "--tension-max nan: must be above 0"),
        ("--motor paper --drive native --node-id 99", "node_id"),
    ],
)
def test_what_is_missing_or_wrong_is_told_in_one_line(call: Call, line: str, words: str) -> None:
    rest = ["--motor-pulley-radius-mm", "2", "--jaw-pulley-radius-mm", "1", *needed("paper")] if "node" in line else []
    code, out, err = call("init", "r.yaml", *line.split(), *rest)
    assert (code, out) == (2, "")
    assert err.startswith("hil-forceps: ")
    assert words in err
    assert err.count("\n") == 1
    assert not Path("r.yaml").exists()


def test_on_a_terminal_it_asks_for_what_is_missing(
    call: Call, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = "maxon-ec13\nmaxon-ec13-305194\nmoteus\n\n2\n1.4\n\n16384\n\n"
    monkeypatch.setattr("hil_forceps.cli.arguments.first_rig.can_ask", lambda: True)
    monkeypatch.setattr(questions, "can_ask", lambda: True)
    monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
    code, _, err = call("init", "r.yaml")
    del capsys
    assert code == 0, err
    assert "did you mean maxon-ec13" in err
    assert "Current limit, A [0.312]:" in err
    rig = load_rig("r.yaml")
    assert rig.drive_profile == "moteus"
    assert rig.motor.torque_constant_N_m_per_A.value == 8.03e-3
    assert rig.forceps.jaw_pulley_radius_m.value == 1.4e-3


def test_the_end_of_the_input_is_no_answer(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil_forceps.cli.arguments.first_rig.can_ask", lambda: True)
    code, _, err = call("init", "r.yaml")
    assert code == 2
    assert "hil-forceps: missing options: --motor NAME" in err


def test_the_list_and_json(call: Call) -> None:
    code, out, _ = call("init", "--list")
    assert code == 0
    assert all(f"--motor {name}\n" in out for name in presets.motors())
    assert all(f"--drive {name}\n" in out for name in presets.drives())
    listed = json.loads(call("init", "--list", "--json")[1])
    assert listed["motors"]["maxon-ec13-305194"]["values"]["torque_constant_N_m_per_A"]["value"] == 8.03e-3
    line = ("init", "r.yaml", "--motor", "paper", "--drive", "native", *needed("paper"), *FORCEPS)
    code, out, err = call(*line, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["without_value"][0] == "forceps.jaw_inertia_kg_m2"
    assert call(*line, "--overwrite", "--quiet")[2] == ""


def test_a_gear_scales_what_is_at_the_motor(call: Call) -> None:
    line = ("--motor", "faulhaber-3564k024b", "--encoder-counts", "4096", *PULLEYS, "--assume")
    call("init", "direct.yaml", "--drive", "odrive", *line)
    call("init", "geared.yaml", "--drive", "odrive", *line, "--gear", "-5")
    call("init", "native.yaml", "--drive", "native", *line, "--gear", "-5")
    one, five, native = (load_rig(f"{name}.yaml") for name in ("direct", "geared", "native"))
    assert five.plant().torque_constant_N_m_per_A == pytest.approx(5 * one.plant().torque_constant_N_m_per_A)
    assert five.plant().motor_inertia_kg_m2 == pytest.approx(25 * one.plant().motor_inertia_kg_m2)
    assert five.plant().motor_viscous_N_m_s_per_rad == pytest.approx(
        25 * one.plant().motor_viscous_N_m_s_per_rad, rel=1e-5
    )
    assert five.plant().motor_coulomb_N_m == pytest.approx(5 * one.plant().motor_coulomb_N_m)
    assert five.motor_driver is not None
    assert five.motor_driver.encoder_rev_per_pulley_rev == -5.0
    assert (five.encoder.counts_per_rev, native.encoder.counts_per_rev) == (4096, 20480)


def test_the_wire_limits_the_current(call: Call) -> None:
    line = ("--motor", "maxon-ec45-flat-50w-24v", "--drive", "moteus", "--encoder-counts", "4096", *PULLEYS)
    call("init", "r.yaml", *line, "--tension-max", "5")
    rig = load_rig("r.yaml")
    assert rig.drive is not None
    assert rig.drive.current_limit_A == pytest.approx(5 * 10e-3 / 36e-3, rel=1e-5)
    assert rig.limits.tension_max_N == 5


UNITS = {
    "mNm/A": "mN_m_per_A", "Nm/A": "N_m_per_A", "gcm2": "g_cm2", "mA": "mA", "A": "A", "mNm": "mN_m", "Nm": "N_m",
    "rpm": "rpm", "rad/s": "rad_per_s", "mNm/rpm": "mN_m_per_rpm",
}  # fmt: skip
OF_KEY = {"A": "A", "N_m": "N_m", "rad_per_s": "rad_per_s", "kg_m2": "kg_m2", "N_m_per_A": "N_m_per_A"}
AS_QUOTED = re.compile(
    r"(-?\d[\d ]*(?:\.\d+)?(?:e-?\d+)?) (mNm/rpm|mNm/A|Nm/A|gcm2|mNm|Nm|mA|A|rpm|rad/s)(?=$|[ ,;()])"
)


def quotes() -> list[tuple[str, str, float, float]]:
    """Return preset, key, value and what its source quotes in its own unit, converted: where one number is quoted."""
    found = []
    for name, motor in presets.motors().items():
        for key, fact in motor.values:
            quoted = AS_QUOTED.findall(fact.source) if fact is not None else []
            if len(quoted) != 1 or "times" in fact.source or " over " in fact.source:
                continue
            number, unit = quoted[0]
            of_key = next(
                unit for unit in ("N_m_s_per_rad", "N_m_per_A", "rad_per_s", "kg_m2", "N_m", "A") if key.endswith(unit)
            )
            by = factor(UNITS[unit], of_key)
            assert by is not None, (name, key, unit)
            found.append((name, key, float(fact.value), float(number.replace(" ", "")) * by))
    return found


def test_presets_have_their_sources_numbers() -> None:
    """A value in SI and the number that its source quotes in the data sheet's unit are the same."""
    found: Any = quotes()
    assert len(found) >= 40
    wrong = [
        (name, key, value, quoted) for name, key, value, quoted in found if value != pytest.approx(quoted, rel=1e-4)
    ]
    assert wrong == []


def test_every_preset_has_a_source() -> None:
    for preset in presets.motors().values():
        assert len(preset.source) > 20
        assert all(fact is None or fact.source for _, fact in preset.values)
    root = Path(__file__).parents[3]
    assert all((root / preset.page).is_file() for preset in presets.drives().values())
