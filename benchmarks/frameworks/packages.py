"""Rows of the page: frameworks, their estimators and their properties as documented."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Framework:
    """An estimation framework and one of its estimators.

    Attributes
    ----------
    name : of the package.
    label : of the estimator in this project.
    reference : estimator of this project with the same algorithm.
    distributions : of which the installation consists, besides what ggbench needs anyway.
    adapter : file that adapts it.
    singular, missing, noise, loss : how it takes a singular Q, missing channels, R of each epoch,
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
FRAMEWORKS = (
    Framework("filterpy", "filterpy-ekf", "ekf", ("filterpy",), "estimators/filterpy_ekf.py",
              "yes", BY, BY, BY),
    Framework("filterpy", "filterpy-ukf", "ukf", ("filterpy",), "estimators/filterpy_ukf.py",
              "yes", BY, BY, BY),
    Framework("gtsam", "gtsam[mode=batch]", "factor-graph[mode=batch]", ("gtsam",),
              "estimators/gtsam_smoothers.py", BY, BY, "yes", "yes"),
    Framework("pyceres", "pyceres-batch", "factor-graph[mode=batch]", ("pyceres",),
              ADAPTERS + "pyceres.py", BY, BY, "yes"),
    Framework("Stone Soup", "stonesoup-ekf", "ekf", ("stonesoup",), ADAPTERS + "stonesoup.py",
              "yes", BY, "yes"),
    Framework("Stone Soup", "stonesoup-ukf", "ukf", ("stonesoup",), ADAPTERS + "stonesoup.py",
              "yes", BY, "yes"),
    Framework("dynamax", "dynamax-ekf", "ekf", ("dynamax", "jax", "jaxlib"),
              ADAPTERS + "dynamax.py", "yes", BY, "yes"),
    Framework("dynamax", "dynamax-ukf", "ukf", ("dynamax", "jax", "jaxlib"),
              ADAPTERS + "dynamax.py", "yes", BY, "yes"),
    Framework("cuthbert", "cuthbert-ekf", "ekf", ("cuthbert", "cuthbertlib", "jax", "jaxlib"),
              ADAPTERS + "cuthbert.py", "yes", BY, "yes"),
    Framework("bayesfilter", "bayesfilter-ekf", "ekf", ("bayesfilter",),
              ADAPTERS + "bayesfilter.py", "yes", BY, "yes"),
    Framework("bayesfilter", "bayesfilter-ukf", "ukf", ("bayesfilter",),
              ADAPTERS + "bayesfilter.py", "yes", BY, "yes"),
    Framework("kalbee", "kalbee-ekf", "ekf", ("kalbee",), ADAPTERS + "kalbee.py",
              "yes", BY, BY),
    Framework("kalbee", "kalbee-ckf", "ukf", ("kalbee",), ADAPTERS + "kalbee.py",
              "yes", BY, BY),
)  # fmt: skip

OTHERS = (
    ("pykalman, simdkalman, statsmodels", "linear, or one Q and R"),
    ("symforce", "symbolic residuals"),
    ("pyrecest", "filterpy's code"),
    ("g2o", "as pyceres"),
)
"""Packages without a row, and why."""
