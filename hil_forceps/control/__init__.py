"""Trajectories, compensator and limit gate."""
