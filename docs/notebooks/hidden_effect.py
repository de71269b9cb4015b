"""An effect hidden in a simulated forceps, found from its runs, and what knowing it gains.

To look at and to change: `marimo edit docs/notebooks/hidden_effect.py`. As a page: `marimo export html
docs/notebooks/hidden_effect.py -o hidden_effect.html`.
"""

import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium")


@app.cell
def _():
    import marimo as mo
    import matplotlib.pyplot as plt
    import numpy as np

    import hil_forceps as hf

    return hf, mo, np, plt


@app.cell
def _(mo):
    mo.md(r"""
    # An effect that the model lacks

    A simulated forceps does something that its model does not know. From what a bench records of it the diagnosis names
    the cause and its size; a model with that cause in it predicts better, and its estimate of the load is better.

    The forceps and the model that is diagnosed share no code: one is `virtual_bus`, reached through python-can as
    hardware would be. Not a medical device.

    ## What is known

    The rig: the paper's forceps with an encoder of 14 bits and sensors that scatter; drive and host at 1 kHz.
    """)


@app.cell
def _(hf, mo):
    configs = mo.notebook_dir().parents[1] / "configs"
    rig = hf.load_rig(configs / "realistic.yaml").with_changes(
        {
            "drive.sample_time_s": 1e-3,
            "drive.kp_A_per_rad": 1.2,
            "drive.ki_A_per_rad_s": 15.0,
            "bench.feedback_divider": 1,
        }
    )
    return (rig,)


@app.cell
def _(mo):
    mo.md(r"""
    ## Simulate

    A motion of the jaw, a load on it, and what the model says that the motor will do.
    """)


@app.cell
def _(hf, np):
    def course(values, duration_s):
        """Return a trajectory of `values(t)` that begins and ends at rest at the value for no motion."""
        time_s = np.arange(0.0, duration_s + 0.005, 0.01)
        ends = np.clip(np.minimum(time_s, duration_s - time_s) / 0.5, 0.0, 1.0)
        return hf.Trajectory(tuple(time_s.tolist()), tuple(values(time_s, np.sin(np.pi / 2 * ends) ** 2).tolist()))

    def sines(time_s, frequencies_Hz, phase):
        return sum(np.sin(2 * np.pi * f * time_s + phase * k) / (1 + k) for k, f in enumerate(frequencies_Hz))

    def motion_of(phase, duration_s=3.0):
        return course(lambda t, ease: np.pi / 2 - 0.45 * ease * sines(t, (0.6, 1.7), phase), duration_s)

    def load_of(phase, duration_s=3.0):
        return course(lambda t, ease: 1.5e-3 * ease * sines(t, (0.4, 1.1), 1.0 + phase), duration_s)

    return load_of, motion_of


@app.cell
def _(hf, load_of, motion_of, np, plt, rig):
    plain = hf.simulate(rig, motion_of(0.0), load_N_m=load_of(0.0))

    def panels(rows):
        figure, axes = plt.subplots(rows, 1, sharex=True, figsize=(7.0, 1.7 * rows), layout="constrained")
        for one in axes:
            one.spines[["top", "right"]].set_visible(False)
            one.margins(x=0)
        figure.align_ylabels()
        axes[-1].set_xlabel("time (s)")
        return figure, axes

    def legend_above(axes):
        axes.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)

    plain_figure, _axes = panels(3)
    _axes[0].plot(plain["time_s"], np.degrees(plain["theta_j_rad"]), color="black")
    _axes[0].set_ylabel("jaw (deg)")
    _axes[1].plot(plain["time_s"], 1e3 * plain["tau_w_N_m"], color="black")
    _axes[1].set_ylabel("load (mN m)")
    _axes[2].plot(plain["time_s"], 1e3 * plain["current_A"], color="black", lw=0.8)
    _axes[2].set_ylabel("current (mA)")
    plain_figure
    return legend_above, panels


@app.cell
def _(mo):
    mo.md(r"""
    ## Hide

    Viscous friction of the motor that differs by direction, by a third of what the rig says. `effects:` in the rig of
    the bench makes it happen there; the rig of the model stays as it is. Two runs to fit, one of another motion to
    judge by.
    """)


@app.cell
def _(hf, load_of, motion_of, rig):
    true_difference = 4e-5  # N m s/rad
    world = rig.with_changes({"effects": {"viscous_asymmetry": {"difference_N_m_s_per_rad": true_difference}}})

    def measured(place, phase):
        with hf.virtual_bench(world, load_N_m=load_of(phase), seed=place) as bench:
            return bench.run(motion_of(phase)).recorded

    runs = hf.read_runs(
        *(measured(place, phase) for place, phase in enumerate((0.0, 1.3, 2.6))), names=["one", "two", "another motion"]
    )
    return runs, true_difference


@app.cell
def _(hf, legend_above, mo, panels, rig, runs):
    before = hf.simulate(rig, runs[2])

    beside_figure, _axes = panels(2)
    _axes[0].plot(before["time_s"], 1e3 * before.measured["current_A"], color="0.6", label="measured")
    _axes[0].plot(before["time_s"], 1e3 * before["current_A"], color="#0072b2", lw=0.8, label="simulated")
    _axes[0].set_ylabel("current (mA)")
    legend_above(_axes[0])
    _axes[1].plot(before["time_s"], 1e3 * (before["current_A"] - before.measured["current_A"]), color="#d55e00", lw=0.8)
    _axes[1].set_ylabel("error (mA)")
    mo.vstack(
        [
            beside_figure,
            mo.md(
                f"The error of {1e3 * before.rmse('current_A'):.1f} mA is more than the sensor's 1 mA, and has a shape."
            ),
        ]
    )
    return (before,)


@app.cell
def _(mo):
    mo.md(r"""
    ## Diagnose

    The catalogue holds 35 effects. So that this page takes seconds and not minutes, six are looked for here: three of
    the motor's friction, its ripple, and two of the wire.
    """)


@app.cell
def _(hf, rig, runs):
    from hil_forceps.rig.catalogue import EFFECT_IDS

    suspects = {
        "viscous_asymmetry",
        "coulomb_asymmetry",
        "load_dependent_friction",
        "torque_ripple",
        "wire_damping",
        "wire_hardening",
    }
    result = hf.diagnose(
        runs, rig, hold_out=["another motion"], without=[name for name in EFFECT_IDS if name not in suspects]
    )
    result
    return (result,)


@app.cell
def _(mo, result, true_difference):
    found = result.parameters[0]
    mo.md(f"""
    `{found.name}` is {found.value:.3g} ({found.low:.3g} to {found.high:.3g}); hidden was {true_difference:.3g}.
    """)
    return (found,)


@app.cell
def _(mo):
    mo.md(r"""
    ## Extend

    `result.extended_rig` is the rig with the cause in it. The same simulation with it, of the run that was held out:
    """)


@app.cell
def _(before, hf, legend_above, panels, result, runs):
    after = hf.simulate(result.extended_rig, runs[2])

    errors_figure, _axes = panels(2)
    for _one, _name, _scale, _label in (
        (_axes[0], "current_A", 1e3, "current error (mA)"),
        (_axes[1], "theta_j_rad", 1e3, "jaw error (mrad)"),
    ):
        _one.plot(
            before["time_s"], _scale * (before[_name] - before.measured[_name]), color="#d55e00", lw=0.8, label="before"
        )
        _one.plot(
            after["time_s"], _scale * (after[_name] - after.measured[_name]), color="#009e73", lw=0.8, label="after"
        )
        _one.set_ylabel(_label)
    legend_above(_axes[0])
    errors_figure
    return (after,)


@app.cell
def _(mo):
    mo.md(r"""
    ## Gain

    What the drive measures, angle and current, through the Kalman filter: the load on the jaw, with the rig as it was
    and with the extended one. The load cell of the bench is there to compare with; a real forceps has none.
    """)


@app.cell
def _(hf, legend_above, mo, np, panels, result, rig, runs):
    run = runs[2]
    estimates = {
        name: hf.Estimator("kalman", known, 1e-3)
        .estimate(run["theta_m_rad"], run["current_A"], run["time_s"])
        .tau_w_N_m
        for name, known in (("before", rig), ("after", result.extended_rig))
    }
    errors_N_m = {name: float(np.std(values - run["tau_w_N_m"])) for name, values in estimates.items()}

    gain_figure, _axes = panels(2)
    _axes[0].plot(run["time_s"], 1e3 * run["tau_w_N_m"], color="black", lw=2.0, label="load cell")
    for _name, _color in (("before", "#d55e00"), ("after", "#009e73")):
        _axes[0].plot(run["time_s"], 1e3 * estimates[_name], color=_color, lw=0.8, label=_name)
        _axes[1].plot(run["time_s"], 1e6 * (estimates[_name] - run["tau_w_N_m"]), color=_color, lw=0.8)
    _axes[0].set_ylabel("load (mN m)")
    legend_above(_axes[0])
    _axes[1].set_ylabel("error (µN m)")
    mo.vstack(
        [
            gain_figure,
            mo.md(
                f"The estimate scatters by {1e6 * errors_N_m['before']:.0f} µN m before and "
                f"{1e6 * errors_N_m['after']:.0f} µN m after."
            ),
        ]
    )
    return (errors_N_m,)


if __name__ == "__main__":
    app.run()
