"""How far python-can's udp_multicast reaches: nothing but a group's address protects it."""

from collections.abc import Iterator, Mapping

from hil_forceps.bridge.doctor.check import Check, Verdict


def checks(options: Mapping[str, object]) -> Iterator[Check]:
    """Look at the interface's options."""
    name, what = "udp.scope", "how far frames over UDP multicast reach"
    hops = options.get("hop_limit", 0)
    if hops == 0:
        yield Check(name, what, Verdict.OK, "this computer only (loopback interface)", "", 0.0, "hops")
        return
    text = f"hop_limit is {hops}: every device in this network can read all frames and send references"
    yield Check(name, what, Verdict.WARN, text, "leave --option hop_limit out, or use a separate network")
