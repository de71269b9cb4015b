"""What a run leaves beside its recording: the raw bus, and the second before a fault."""
