"""Many sessions: work distributed over processes or a cluster, each result stored when it is ready."""
