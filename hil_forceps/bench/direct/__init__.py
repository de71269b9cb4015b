"""Runs without the bus: samples go directly to estimator, compensation and gate."""
