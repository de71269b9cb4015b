"""The reference of the Python API: the names of `hil_forceps.__all__`, for mkdocstrings to fill in from docstrings."""

import hil_forceps as hf

HEAD = """# API reference

Every name that programs may rely on, from its docstring. Examples of each: [Python API](python-api.md).
Quantities are SI, with the unit in the name.
"""
# By what somebody wants to do; a name that is missing here, or too many, ends the build.
GROUPS = {
    "Rigs": ("load_rig", "Rig", "UserError"),
    "Runs": ("read_runs", "Run"),
    "Simulation": ("simulate", "Simulation", "virtual_bench", "VirtualBench", "Trajectory"),
    "Diagnosis": ("diagnose", "DiagnosisResult"),
    "Sessions": ("track", "trend", "TrendResult"),
    "Estimation and control": ("Estimator", "Service", "ServiceRun"),
}


def page() -> str:
    """Return the page: a heading a group, a directive a name."""
    named = [name for names in GROUPS.values() for name in names]
    if sorted(named) != sorted(hf.__all__):
        raise ValueError(f"not grouped, or no name of the API: {set(named) ^ set(hf.__all__)}")
    parts = [HEAD]
    for group, names in GROUPS.items():
        parts += [f"## {group}\n", *(f"::: hil_forceps.{name}\n" for name in names)]
    return "\n".join(parts)
