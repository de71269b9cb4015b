"""Entry point of `hil-forceps`: the commands, and how errors reach the user. Nothing heavy is imported here."""

import logging
import os
import sys
from typing import Any, TextIO

from cyclopts import App, CycloptsError, Parameter

from hil_forceps import __version__
from hil_forceps.cli.arguments import made_folders
from hil_forceps.cli.examples import EXAMPLES
from hil_forceps.cli.terminal.notes import without_quiet
from hil_forceps.rig.errors import UserError

EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130

# Commands use their own threads or processes. Threads of BLAS would compete with them for the cores: a diagnosis takes
# up to three times as long. numpy reads this when it is loaded, later than here.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Optimised at level 2, kernels are as fast as at 3, numba's own, and compile in three quarters of the time.
# Read when numba is loaded.
os.environ.setdefault("NUMBA_OPT", "2")

app = App(
    name="hil-forceps",
    help="Bridge and bench for wire-actuated surgical forceps. Not a medical device.",
    version=__version__,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative_iterable=()),  # no --empty-… for each option that may be repeated
)

# Commands are named by import path, so that `--help` loads none of them; each is a function named as its file.
for _name, _path, _help in (
    ("bench", "runs.bench", "Run the paper's simulations through the bus; write table, figures and recordings."),
    ("run", "runs.run", "Control a motor driver, real or simulated, on a CAN interface or serial port."),
    ("drive", "drives.drive", "Start the simulated drive and forceps in a separate process."),
    ("conformance", "drives.conformance", "Test a drive against the protocol's requirements; write a certificate."),
    ("decode", "drives.decode", "Decode frames or bus logs into signals."),
    ("diagnose", "measured.diagnose", "Compare a simulation with measured runs, and find the cause of the difference."),
    ("trend", "measured.trend", "Estimate parameters over many sessions; report which change, and since when."),
    ("replay", "runs.replay", "Run the estimators again on a recording, or on measured runs of real forceps."),
    ("recover", "runs.recover", "List what a damaged recording contains, and write a valid recording from it."),
    ("explain", "runs.explain", "List the events of a run, what ended it, and likely causes."),
    ("import", "measured.import_", "Convert measured runs to the project's format, and audit the data."),
    ("simulate", "measured.simulate", "Simulate a measured run with a rig file, and compare each channel."),
    ("fmu", "fmu", "Write plant or estimator as an FMU for Simulink, Dymola, OpenModelica and others."),
    ("init", "init", "Write a first rig file from motor, drive, encoder and pulleys."),
    ("schema", "schema", "Print the JSON schema of rig files or bench files, for editors."),
    ("configs", "configs", "List the example rig files, print one, or write them to a folder."),
    ("docs", "docs", "List the pages of the documents, or print one."),
    ("open", "open_", "Open the newest report of a folder in the browser."),
    ("check", "drives.check", "Check whether the settings of a rig file are consistent; nothing is connected."),
    ("doctor", "drives.doctor", "Check computer, line, rig file and drive before motion; each check has a remedy."),
    ("scan", "drives.scan", "List the drives on a bus or port, by listening only."),
    ("info", "info", "Show what is installed and connected, or figures derived from a rig file."),
):
    # `drive` passes on its whole command line, --help too: only the drive itself knows its options.
    _own: dict[str, Any] = {"help_flags": [], "version_flags": []} if _name == "drive" else {}
    _own["help_epilogue"] = f"Example:\n\n    {EXAMPLES[_name]}\n\nWith --quiet only errors go to standard error."
    _function = _path.rpartition(".")[2]
    app.command(f"hil_forceps.cli.commands.{_path}:{_function}", name=_name, help=_help, **_own)
app.register_install_completion_command(help="Install completion of commands and options for your shell.")


def main(arguments: list[str] | None = None) -> None:
    """Run one command; exit code 2 with one line for each problem that the user can solve."""
    logging.getLogger("can").setLevel(logging.CRITICAL)  # each problem is reported once, by this program
    if _is_closed(sys.stdout):
        sys.stderr.write("hil-forceps: standard output is closed; redirect it to a file or to /dev/null\n")
        sys.exit(EXIT_USER_ERROR)
    try:
        code = _run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output ended early (`| head`): no error.
        _drop_output()
        code = 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        sys.stderr.write(f"hil-forceps: {where}{error.strerror or error}\n")
        _drop_output()
        code = EXIT_USER_ERROR
    sys.exit(code)


def _is_closed(stream: TextIO | None) -> bool:
    return stream is None


def _run(arguments: list[str] | None) -> int:
    made_folders.forget()
    try:
        words = sys.argv[1:] if arguments is None else arguments
        if words[:1] != ["drive"]:  # the drive parses its own line
            words = without_quiet(words)
            _help_in_full(words)
        result = app(words, exit_on_error=False, print_error=False)
    except UserError as error:
        made_folders.remove_empty()
        for problem in error.problems:
            sys.stderr.write(f"hil-forceps: {problem}\n")
        return EXIT_USER_ERROR
    except CycloptsError as error:
        from hil_forceps.cli.mistakes import told  # noqa: PLC0415 - difflib, for mistakes only

        sys.stderr.write(f"hil-forceps: {told(error, EXAMPLES)}\n")
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("hil-forceps: interrupted\n")
        return EXIT_INTERRUPTED
    except SystemExit as ended:  # from the drive's own parser, or from a help text whose reader ended
        result = ended.code
    return result if isinstance(result, int) else 0


def _help_in_full(words: list[str]) -> None:
    """Show a command's whole docstring for `COMMAND --help`; the list of commands has one line for each."""
    if words[:1] and words[0] in EXAMPLES and {"--help", "-h"} & set(words):
        app[words[0]].help = None


def _drop_output() -> None:
    """Redirect standard output to the null device, so that flushing its buffer at exit can't fail again."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


if __name__ == "__main__":
    main()
