"""Many sessions at once: work spread over processes or a cluster, results kept as they come."""
