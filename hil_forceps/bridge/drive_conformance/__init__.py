"""Whether a drive keeps what its profile promises: one suite over the machine's port for every profile. Pure."""
