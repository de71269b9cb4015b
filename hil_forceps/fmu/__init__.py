"""Functional mock-up units: the plant and the estimators as C, for Simulink, Dymola, OpenModelica and others."""
