"""Seeded schedules of faults against the whole service in virtual time, and what must hold in every run."""
