"""Frameworks of the comparison, with their estimators and documented properties."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Framework:
    """Estimation framework and one of its estimators.

    Attributes
    ----------
    name : name of the package.
    label : label of the estimator in ggbench.
    reference : label of ggbench's own estimator with the same algorithm.
    distributions : installed distributions, without the requirements of ggbench.
    adapter : file of the adapter.
    singular, missing, noise, loss : support for a singular Q, missing channels, R of each epoch,
        and a robust loss per channel: yes, no, or by the adapter.
    """

    name: str
    label: str
    reference: str
    distributions: tuple[str, ...]
    adapter: str
    singular: str
    missing: str
    noise: str
    loss: str = "no"


BY = "by the adapter"
ADAPTERS = "ggbench/adapters/"


def _rows(
    name: str,
    references: dict[str, str],
    adapter: str,
    packages: tuple[str, ...] = (),
    **properties: str,
) -> tuple[Framework, ...]:
    """Return one row per estimator of a package; ``references`` contains references by label."""
    return tuple(
        Framework(name, label, reference, packages or (name,), adapter, **properties)
        for label, reference in references.items()
    )


FRAMEWORKS = (
    *_rows(
        "filterpy",
        {"filterpy-ekf": "ekf"},
        "estimators/filterpy_ekf.py",
        singular="yes",
        missing=BY,
        noise=BY,
        loss=BY,
    ),
    *_rows(
        "filterpy",
        {"filterpy-ukf": "ukf"},
        "estimators/filterpy_ukf.py",
        singular="yes",
        missing=BY,
        noise=BY,
        loss=BY,
    ),
    *_rows(
        "gtsam",
        {"gtsam[mode=batch]": "factor-graph[mode=batch]"},
        "estimators/gtsam_smoothers.py",
        singular=BY,
        missing=BY,
        noise="yes",
        loss="yes",
    ),
    *_rows(
        "pyceres",
        {"pyceres-batch": "factor-graph[mode=batch]"},
        ADAPTERS + "pyceres.py",
        singular=BY,
        missing=BY,
        noise="yes",
    ),
    *_rows(
        "Stone Soup",
        {"stonesoup-ekf": "ekf", "stonesoup-ukf": "ukf"},
        ADAPTERS + "stonesoup.py",
        packages=("stonesoup",),
        singular="yes",
        missing=BY,
        noise="yes",
    ),
    *_rows(
        "dynamax",
        {"dynamax-ekf": "ekf", "dynamax-ukf": "ukf"},
        ADAPTERS + "dynamax.py",
        packages=("dynamax", "jax", "jaxlib"),
        singular="yes",
        missing=BY,
        noise="yes",
    ),
    *_rows(
        "cuthbert",
        {"cuthbert-ekf": "ekf"},
        ADAPTERS + "cuthbert.py",
        packages=("cuthbert", "cuthbertlib", "jax", "jaxlib"),
        singular="yes",
        missing=BY,
        noise="yes",
    ),
    *_rows(
        "bayesfilter",
        {"bayesfilter-ekf": "ekf", "bayesfilter-ukf": "ukf"},
        ADAPTERS + "bayesfilter.py",
        singular="yes",
        missing=BY,
        noise="yes",
    ),
    *_rows(
        "kalbee",
        {"kalbee-ekf": "ekf", "kalbee-ckf": "ukf"},
        ADAPTERS + "kalbee.py",
        singular="yes",
        missing=BY,
        noise=BY,
    ),
)

OTHERS = (
    ("pykalman, simdkalman, statsmodels", "linear models, or constant Q and R"),
    ("symforce", "needs symbolic residuals"),
    ("pyrecest", "filterpy's code"),
    ("g2o", "same method as pyceres"),
)
"""Packages without a row, and the reasons."""
