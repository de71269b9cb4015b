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

# Commands share their work among threads or processes of their own, and BLAS's beside them would only fight for the
# cores: a diagnosis takes up to three times as long. Read when numpy is loaded, later than this.
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
    ("run", "runs.run", "Drive a motor driver, real or simulated, on any CAN interface or serial port."),
    ("drive", "drives.drive", "Start the simulated drive with its forceps as a process of its own."),
    ("conformance", "drives.conformance", "Run the protocol's requirements against a drive; write a certificate."),
    ("decode", "drives.decode", "Turn frames or bus logs into readable signals."),
    ("diagnose", "measured.diagnose", "Show what a simulation gets wrong about measured runs, and name the cause."),
    ("trend", "measured.trend", "Follow parameters over hundreds of sessions; tell what changes, and since when."),
    ("replay", "runs.replay", "Send a recording, or a measured run of a real forceps, through the estimators."),
    ("recover", "runs.recover", "Say what a damaged recording still holds; make a sound one of it."),
    ("explain", "runs.explain", "Tell the course of a run, what ended it, and what may be behind that."),
    ("import", "measured.import_", "Turn measured runs of any known format into the project's own; audit them."),
    ("simulate", "measured.simulate", "Simulate beside a measured run, as it was driven; compare channel by channel."),
    ("fmu", "fmu", "Write plant or estimator as an FMU for Simulink, Dymola, OpenModelica and others."),
    ("init", "init", "Write a first rig file from motor, drive, encoder and pulleys, with their sources."),
    ("schema", "schema", "Print the JSON schema of rig or bench files, for editors."),
    ("docs", "docs", "List the pages of the documents, or print one."),
    ("open", "open_", "Open the newest report of a folder in the browser."),
    ("check", "drives.check", "Look for settings of a rig that don't go together, before anything is connected."),
    ("doctor", "drives.doctor", "Look at machine, line, rig and drive before motion; each check with its remedy."),
    ("scan", "drives.scan", "Tell which drives are on a bus or port, by listening alone."),
    ("info", "info", "Say what is installed and reachable, and what a rig file means."),
):
    # `drive` hands its whole line on, the call for help too: only the drive itself knows its options.
    _own: dict[str, Any] = {"help_flags": [], "version_flags": []} if _name == "drive" else {}
    _own["help_epilogue"] = (
        f"Example:\n\n    {EXAMPLES[_name]}\n\nWith --quiet nothing but errors goes to standard error."
    )
    _function = _path.rpartition(".")[2]
    app.command(f"hil_forceps.cli.commands.{_path}:{_function}", name=_name, help=_help, **_own)
app.register_install_completion_command(help="Install completion of commands and options for your shell.")


def main(arguments: list[str] | None = None) -> None:
    """Run one command; exit code 2 with one clear line for each thing that the user can mend."""
    logging.getLogger("can").setLevel(logging.CRITICAL)  # every problem is told once, by us
    if _is_closed(sys.stdout):
        sys.stderr.write("hil-forceps: standard output is closed; send it to a file, or to /dev/null\n")
        sys.exit(EXIT_USER_ERROR)
    try:
        code = _run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output went away (`| head`): that is its right.
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
        if words[:1] != ["drive"]:  # whose line is its own
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
    except SystemExit as ended:  # the drive's own parser, and a help text whose reader went away
        result = ended.code
    return result if isinstance(result, int) else 0


def _help_in_full(words: list[str]) -> None:
    """Show all of a command's docstring where its own help is asked for; the list of commands has a line of each."""
    if words[:1] and words[0] in EXAMPLES and {"--help", "-h"} & set(words):
        app[words[0]].help = None


def _drop_output() -> None:
    """Point standard output at nothing, so that what its buffer still holds fails no second time at the exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


if __name__ == "__main__":
    main()
