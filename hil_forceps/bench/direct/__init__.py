"""Runs without the bus: samples go straight to estimator, compensation and gate."""
