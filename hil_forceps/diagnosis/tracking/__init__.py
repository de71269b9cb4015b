"""Known parameters of a rig followed over sessions: the fit of one session, without the catalogue of effects."""
