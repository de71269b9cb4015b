"""Runs a command where SocketCAN is: vcan0 and vcan1, both for CAN FD, up, in a network namespace of their own.

    tools/targets/socketcan.py [--where auto|native|uml] [--time auto|real|virtual] [--writable FOLDER] [--limit S]
        -- COMMAND

Natively where this kernel has CAN and we are root or may sudo; else in User-Mode Linux, which needs no rights and
installs nothing. There the host's files are read-only, so the same Python runs inside, and only FOLDER can be written
(may be repeated). Time is virtual there unless asked otherwise: the guest's clock stands still while anything computes
and jumps to the next timer when all sleep, so `sleep 3600` is over at once; a time-out takes exactly what it should.
The command finds HIL_FORCEPS_TIME set to real or virtual.

Exit code: the command's own; 124 when the limit was reached and the guest was killed; 125 when it never came to an end
by itself; 126 when SocketCAN can't be had, with the reason on standard error.
"""

import argparse
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

TOOLS = Path(__file__).resolve().parent
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hil-forceps" / "uml"
TIMED_OUT, NO_END, NOT_AVAILABLE = 124, 125, 126
PASSED_ON = ("PATH", "HOME", "LANG", "LC_ALL", "USER")
PASSED_ON_PREFIXES = ("HIL_FORCEPS_", "PYTHON", "NUMBA_", "HYPOTHESIS_", "PYTEST_")

# The network that the command finds. Failing here is failing: nothing that wants SocketCAN goes on without.
NETWORK = """
ip link set lo up && ip link set lo multicast on && ip route add 239.0.0.0/8 dev lo || exit 126
for device in vcan0 vcan1; do
    ip link add "$device" mtu 72 type vcan && ip link set "$device" txqueuelen 1000 up || exit 126
done
"""

GUEST = """#!/bin/sh
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev 2>/dev/null
mkdir -p /dev/pts /dev/shm
# One processor: whoever is flooded gets its turn when the flood pauses, so it may wait for longer than elsewhere.
echo 8000000 >/proc/sys/net/core/rmem_default
mount -t devpts -o mode=620,ptmxmode=666 devpts /dev/pts; ln -snf pts/ptmx /dev/ptmx
ln -snf /proc/self/fd /dev/fd
ln -snf /proc/self/fd/0 /dev/stdin; ln -snf /proc/self/fd/1 /dev/stdout; ln -snf /proc/self/fd/2 /dev/stderr
mount -t tmpfs tmpfs /dev/shm; mount -t tmpfs tmpfs /run; mkdir -p /run/tmp
for folder in {writable}; do mount -t hostfs -o "$folder" none "$folder"; done
sh {job}/command >/dev/console 2>&1 </dev/null
echo $? >{job}/code
sync
{python} -c 'import ctypes; ctypes.CDLL(None).reboot(0x4321FEDC)'
"""


class NotAvailableError(Exception):
    """SocketCAN, or a kernel to get it from, can't be had here; says why."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--where", choices=("auto", "native", "uml"), default="auto")
    parser.add_argument("--time", choices=("auto", "real", "virtual"), default="auto")
    parser.add_argument("--writable", type=Path, action="append", default=[], help="folder that a guest may write")
    parser.add_argument("--limit", type=float, default=600.0, metavar="S", help="kill it after so long")
    parser.add_argument("--memory-mb", type=int, default=1500, help="of the guest")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    asked = parser.parse_args(arguments)
    command = asked.command[1:] if asked.command[:1] == ["--"] else asked.command
    if not command:
        parser.error("give a command")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    for folder in asked.writable:
        folder.mkdir(parents=True, exist_ok=True)
    try:
        if is_native(asked.where, asked.time):
            os.environ["HIL_FORCEPS_TIME"] = "real"
            return run_native(command, asked.limit)
        os.environ["HIL_FORCEPS_TIME"] = "real" if asked.time == "real" else "virtual"
        options = [f"mem={asked.memory_mb}M", *(["time-travel=inf-cpu"] if asked.time != "real" else [])]
        return run_uml(uml_kernel(), options, command, asked.writable, asked.limit)
    except NotAvailableError as error:
        sys.stderr.write(f"no SocketCAN: {error}\n")
        return NOT_AVAILABLE


def is_native(where: str, time: str) -> bool:
    """Say where to run; NotAvailableError when what is asked for can't be had."""
    if where == "uml" or (where == "auto" and time == "virtual"):
        return False
    if time == "virtual":
        raise NotAvailableError("time is virtual in User-Mode Linux only")
    reason = native_reason()
    if reason is not None and where == "native":
        raise NotAvailableError(reason)
    return reason is None


def native_command(command: Sequence[str]) -> list[str]:
    """Return `command` in a network of its own; /sys is mounted anew because it shows the network it was mounted in."""
    script = f'mount -t sysfs sys /sys || exit 126\n{NETWORK}\nexec "$@"'
    become = [] if os.geteuid() == 0 else ["sudo", "-n", "env", *(f"{key}={value}" for key, value in _environment())]
    return [*become, "unshare", "--net", "--mount", "sh", "-c", script, "sh", *command]


def native_reason() -> str | None:
    """Return why it can't be done natively, or None when it can."""
    for tool in ("ip", "unshare"):
        if shutil.which(tool) is None:
            return f"`{tool}` is not installed"
    probe = "import socket; socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).bind(('vcan0',))"
    done = subprocess.run(
        native_command([sys.executable, "-c", probe]), capture_output=True, text=True, check=False, timeout=60
    )
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    return f"this kernel: {lines[-1] if lines else 'exit code ' + str(done.returncode)}"


def run_native(command: Sequence[str], limit_s: float) -> int:
    """Run in a network of its own on this kernel."""
    # By `timeout`, which has the command's rights: what sudo has started we could not kill.
    limited = ["timeout", "--kill-after=5", f"{limit_s:g}", *command]
    return subprocess.run(native_command(limited), stdin=subprocess.DEVNULL, check=False).returncode


def uml_kernel() -> Path:
    """Return a User-Mode Linux kernel with CAN and virtual time; built where there is none yet."""
    script = TOOLS / "uml_kernel.sh"
    done = subprocess.run(
        [str(script), str(CACHE)], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False
    )
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        raise NotAvailableError(lines[-1] if lines else f"{script.name} ended with {done.returncode}")
    return CACHE / "linux"


def run_uml(kernel: Path, more: Sequence[str], command: Sequence[str], writable: Sequence[Path], limit_s: float) -> int:
    """Boot a guest, run the command in it with its output passed on as it comes, halt."""
    job = Path(tempfile.mkdtemp(prefix="uml-"))
    try:
        _write_job(job, command, writable)
        options = [
            *more, "root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", "quiet", "loglevel=1",
            "con0=null,fd:3", "con=null", "ssl=null", f"uml_dir={job}/", "umid=guest", f"init={job}/init",
        ]  # fmt: skip
        code = _boot(kernel, options, job, limit_s)
        if code == NO_END:
            sys.stderr.write("the guest did not come to an end by itself:\n")
            sys.stderr.write("".join((job / "log").read_text(errors="replace").splitlines(keepends=True)[-20:]))
        return code
    finally:
        shutil.rmtree(job, ignore_errors=True)


def _write_job(job: Path, command: Sequence[str], writable: Sequence[Path]) -> None:
    folders = [job, *(folder.resolve() for folder in writable)]
    words = {"writable": shlex.join(map(str, folders)), "job": shlex.quote(str(job)), "python": sys.executable}
    (job / "init").write_text(GUEST.format(**words))
    (job / "init").chmod(0o755)
    settings = "".join(f"export {key}={shlex.quote(value)}\n" for key, value in _environment())
    # The guest's /tmp is the host's, and read-only like the rest.
    tools = shlex.quote(str(CACHE / "usr" / "bin"))  # of can-utils
    place = f"export TMPDIR=/run/tmp PATH=$PATH:{tools}\ncd {shlex.quote(str(Path.cwd()))}\n"
    (job / "command").write_text(f"{settings}{place}{NETWORK}\nexec {shlex.join(command)}\n")


def _boot(kernel: Path, options: Sequence[str], job: Path, limit_s: float) -> int:
    reader, writer = os.pipe()
    # The guest's console comes by a descriptor of its own: what the kernel's launcher says goes to the log.
    launch = ["sh", "-c", f'exec 3>&{writer} {writer}>&-; exec "$@"', "sh"] if writer != 3 else []
    with (job / "log").open("wb") as log:
        process = subprocess.Popen(
            [*launch, str(kernel), *options],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, pass_fds=(writer,), start_new_session=True,
        )  # fmt: skip
    os.close(writer)
    console = threading.Thread(target=_pass_on, args=(reader,), daemon=True)
    console.start()
    timed_out = False
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        timed_out = True
    finally:  # also when we are told to end: a guest is not to outlive us
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    console.join(5.0)
    if timed_out:
        sys.stderr.write(f"killed: the guest was not done after {limit_s:g} s\n")
        return TIMED_OUT
    try:
        return int((job / "code").read_text())
    except (OSError, ValueError):
        return NO_END


def _pass_on(reader: int) -> None:
    with os.fdopen(reader, "rb") as console:
        for line in console:
            if not line.startswith(b"reboot: System halted"):
                sys.stdout.buffer.write(line.replace(b"\r\n", b"\n"))
                sys.stdout.buffer.flush()


def _environment() -> list[tuple[str, str]]:
    return [(k, v) for k, v in os.environ.items() if k in PASSED_ON or k.startswith(PASSED_ON_PREFIXES)]


if __name__ == "__main__":
    sys.exit(main())
