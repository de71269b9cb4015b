"""What is no run at all."""

from hil_forceps.rig.errors import UserError


class NoRunError(UserError):
    """A table of other people's: in a folder of runs it is left out, by itself it is refused."""
