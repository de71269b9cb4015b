"""`hil-forceps import`: what is written reads back the same, and what can't be is told with the way out."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.cli.main import main
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import Run
from tests.reader_fuzz.sound_logs import candump, traffic

ROOT = Path(__file__).parents[4]
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["import", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return run


def write_run(path: Path, seed: int = 0) -> Run:
    time_s = np.arange(500) / 1000
    noise = np.random.default_rng(seed).normal(size=500)
    columns = {"time_s": time_s, "theta_m_rad": np.sin(9 * time_s) + 1e-4 * noise, "current_A": np.cos(time_s) + noise}
    run = Run(path.stem, columns)
    write_csv(run, path)
    return run


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_runs_of_several_sources_are_written_and_audited(suffix: str, call: Call, tmp_path: Path) -> None:
    (one := tmp_path / "one").mkdir()
    first, second = write_run(one / "a.csv", 1), write_run(tmp_path / "b.csv", 2)
    code, out, err = call(one, tmp_path / "b.csv", "--out", tmp_path / "out", "--format", suffix)
    assert (code, err) == (0, "")
    assert "2 runs, 1000 samples" in out
    assert "excitation" in out
    for run in (first, second):
        (again,) = read_run(tmp_path / "out" / f"{run.name}.{suffix}")
        assert all(again.columns[name].tobytes() == values.tobytes() for name, values in run.columns.items())


def test_the_rig_is_audited_against(call: Call, tmp_path: Path) -> None:
    write_run(tmp_path / "a.csv")
    _, out, _ = call(tmp_path / "a.csv", "--out", tmp_path / "out")
    assert "sample_rate" not in out
    _, out, _ = call(tmp_path / "a.csv", "--out", tmp_path / "out", "--rig", ROOT / "configs" / "realistic.yaml")
    assert "sample_rate" in out


def test_sources_that_are_missing_are_told_in_one_line_and_the_docs_say_where_to_get_data(
    call: Call, tmp_path: Path
) -> None:
    code, out, err = call(tmp_path / "none.zip", "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert err == f"hil-forceps: {tmp_path}/none.zip: no such file or folder; check the path\n"
    docs = Path(__file__).parents[4] / "docs"
    assert "mis-tool-characterization" in (docs / "real-input.md").read_text(encoding="utf-8")
    assert "nonlinearbenchmark.org" in (docs / "real-data.md").read_text(encoding="utf-8")
    assert call("--out", tmp_path)[0] == 2
    assert not (tmp_path / "out").exists()


def test_every_bad_source_is_told_and_nothing_is_written(call: Call, tmp_path: Path) -> None:
    write_run(tmp_path / "good.csv")
    (tmp_path / "bad.csv").write_text("time_ms,theta_m_rad,current_A\n")
    (tmp_path / "empty.csv").touch()
    code, _, err = call(*(tmp_path / f"{name}.csv" for name in ("good", "bad", "empty")), "--out", tmp_path / "out")
    assert code == 2
    assert len(err.splitlines()) == 2
    assert not (tmp_path / "out").exists()


def test_names_that_meet_are_told_apart_or_refused(call: Call, tmp_path: Path) -> None:
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        write_run(tmp_path / folder / "a.csv")
    code, _, _ = call(tmp_path / "x", tmp_path / "y", "--out", tmp_path / "out")
    assert code == 0
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["x-a.csv", "y-a.csv"]
    code, _, err = call(tmp_path / "x" / "a.csv", tmp_path / "y" / "a.csv", "--out", tmp_path / "out")
    assert (code, "two runs would have the file name a.csv" in err) == (2, True)
    before = (tmp_path / "x" / "a.csv").read_bytes()
    code, _, err = call(tmp_path / "x" / "a.csv", "--out", tmp_path / "x")
    assert (code, "is also a source, and would be overwritten" in err) == (2, True)
    assert (tmp_path / "x" / "a.csv").read_bytes() == before


def test_one_bus_of_a_log_may_be_chosen(call: Call, tmp_path: Path) -> None:
    lines = [line for bus in ("can0", "can1") for line in candump(traffic(30), bus)]
    (tmp_path / "two.log").write_bytes(b"".join(lines))
    code, _, err = call(tmp_path / "two.log", "--out", tmp_path / "out")
    assert (code, "can0 node 1 (120 frames), can1 node 1 (120 frames); choose one with --bus" in err) == (2, True)
    code, out, _ = call(tmp_path / "two.log", "--out", tmp_path / "out", "--bus", "can1", "--node", "1")
    assert (code, "1 run, 28 samples" in out) == (0, True)
    code, _, err = call(tmp_path / "two.log", "--out", tmp_path / "out", "--bus", "can1", "--node", "9")
    assert (code, "use --node with one of node 1" in err) == (2, True)


def test_out_is_needed(call: Call, tmp_path: Path) -> None:
    code, _, err = call(tmp_path)
    assert (code, "--out: missing" in err) == (2, True)


def test_a_mapping_is_proposed_corrected_and_used(call: Call, tmp_path: Path) -> None:
    rows = "".join(f"{n};{n / 2};{10 * n}\n".replace(".", ",") for n in range(50))
    (tmp_path / "a.csv").write_text(f"Zeit;Position [deg];Strom\nms;;mA\n{rows}")
    kept = tmp_path / "map.yaml"
    code, _, err = call(tmp_path / "a.csv", "--write-map", kept)
    assert code == 2
    assert "add --map time_s=Zeit:ms --map 'theta_m_rad=Position [deg]:deg' --map current_A=Strom:mA" in err
    assert f"remove the #, and use --map {kept}" in err
    assert "# theta_m_rad: 'Position [deg]:deg'\n" in kept.read_text()
    assert call(tmp_path / "a.csv", "--map", kept, "--out", tmp_path / "out")[0] == 2  # of comments alone
    proposed = kept.read_text().replace("# time_s", "time_s").replace("# theta_m", "theta_m")
    kept.write_text(proposed.replace("# current_A", "current_A"))
    code, out, _ = call(
        tmp_path / "a.csv", "--map", kept, "--out", tmp_path / "out", "--write-map", tmp_path / "used.yaml"
    )
    assert code == 0
    assert "column 'Strom' was read as current_A, from mA, times 0.001" in out
    (run,) = read_run(tmp_path / "out" / "a.csv")
    np.testing.assert_array_equal(run.columns["current_A"], 0.001 * (10.0 * np.arange(50)))
    assert call(tmp_path / "a.csv", "--map", tmp_path / "used.yaml", "--out", tmp_path / "again")[0] == 0
    assert (tmp_path / "again" / "a.csv").read_bytes() == (tmp_path / "out" / "a.csv").read_bytes()
