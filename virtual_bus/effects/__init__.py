"""The truth plant with the effects of a rig's `effects:` section: what adds to a sum is one file for each effect."""
