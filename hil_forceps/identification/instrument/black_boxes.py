"""Black boxes to compare with: jaw torque and jaw angle from the motor side's momentary values, no memory.

Linear and quadratic regression need nothing more. Gradient boosting and the network come from scikit-learn, which is
an optional extra; it is imported only when one of them is asked for.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_forceps.rig.errors import UserError

Matrix = NDArray[np.float64]
Predict = Callable[[Matrix], Matrix]
Fit = Callable[[Matrix, Matrix], Predict]

LINEAR, QUADRATIC, BOOSTING, NETWORK = "linear regression", "quadratic regression", "gradient boosting", "network"
SEED = 20180001
HIDDEN_NEURONS = 30  # the publication's


def black_boxes(*, with_learned: bool) -> dict[str, Fit]:
    """Return fits by name, each from inputs [rows, n] and targets [rows, 2] to a prediction.

    `with_learned` adds gradient boosting and the network; UserError when scikit-learn isn't installed.
    """
    fits: dict[str, Fit] = {LINEAR: _linear, QUADRATIC: _quadratic}
    if with_learned:
        _learning("ensemble")
        fits |= {BOOSTING: _boosting, NETWORK: _network}
    return fits


def _learning(module: str) -> Any:
    try:
        return import_module(f"sklearn.{module}")
    except ImportError as error:
        raise UserError(
            "gradient boosting and the network need scikit-learn, which isn't installed: "
            "pip install 'hil-forceps[comparison]', or leave --black-boxes out"
        ) from error


def _linear(x: Matrix, y: Matrix) -> Predict:
    return _least_squares(x, y, lambda z: np.column_stack([np.ones(len(z)), z]))


def _quadratic(x: Matrix, y: Matrix) -> Predict:
    first, second = np.triu_indices(x.shape[1])
    return _least_squares(x, y, lambda z: np.column_stack([np.ones(len(z)), z, z[:, first] * z[:, second]]))


def _least_squares(x: Matrix, y: Matrix, expand: Callable[[Matrix], Matrix]) -> Predict:
    scale = _scaler(x)
    solution = np.linalg.lstsq(expand(scale(x)), y, rcond=None)[0]
    return lambda z: expand(scale(z)) @ solution


def _boosting(x: Matrix, y: Matrix) -> Predict:
    model = _learning("ensemble").HistGradientBoostingRegressor
    fitted = [model(random_state=SEED).fit(x, column) for column in y.T]
    return lambda z: np.column_stack([each.predict(z) for each in fitted])


def _network(x: Matrix, y: Matrix) -> Predict:
    scale, middle, spread = _scaler(x), np.mean(y, axis=0), np.std(y, axis=0)
    model = _learning("neural_network").MLPRegressor(
        hidden_layer_sizes=(HIDDEN_NEURONS,), activation="tanh", solver="lbfgs", max_iter=400, random_state=SEED
    )
    with np.errstate(all="ignore"):
        fitted = _quietly(model, scale(x), (y - middle) / spread)
    return lambda z: fitted.predict(scale(z)) * spread + middle


def _quietly(model: Any, x: Matrix, y: Matrix) -> Any:
    """Fit; that it ended at its number of iterations and not by itself is how it is meant to end."""
    import warnings  # noqa: PLC0415  # only here

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", _learning("exceptions").ConvergenceWarning)
        return model.fit(x, y)


def _scaler(x: Matrix) -> Callable[[Matrix], Matrix]:
    middle, spread = np.mean(x, axis=0), np.std(x, axis=0)
    spread[spread == 0.0] = 1.0
    return lambda z: (z - middle) / spread
