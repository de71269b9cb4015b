"""Estimators of reaction torque and wire elongation behind one interface."""
