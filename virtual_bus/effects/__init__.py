"""The truth plant with the effects of a rig's `effects:` section."""
