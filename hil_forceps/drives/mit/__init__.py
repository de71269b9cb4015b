"""A mini cheetah drive: bgkatz's firmware, CubeMars AK, DaMiao."""
