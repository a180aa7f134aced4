"""The multiple-model filter in NumPy: one textbook filter after the other, narrow priors only."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad
from scipy.linalg import block_diag, expm

from ggbench.engines.model_hypotheses import Hypothesis
from ggbench.engines.robust_weights import losses
from ggbench.gravity.ellipsoid import normal_gradient_of
from ggbench.problem import MeasurementModel, Problem

from .textbook import Update

MGAL = 1e-5
"""In m/s²."""


def mixture(
    hypotheses: Sequence[Hypothesis], iterations: int, problem: Problem
) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Run a filter of each hypothesis; mix them by the sums of their evidence.

    Return means (K, n), covariances (K, n, n) and what each kind weighs at the end.
    """
    found, evidences, priors = [], [], []
    for hypothesis in hypotheses:
        mean, cov, evidence = _filtered(problem, hypothesis, iterations)
        if hypothesis.estimate is not None:
            mean, cov, _ = _filtered(problem, hypothesis.estimate, iterations)
        found.append((mean, cov))
        evidences.append(evidence)
        priors.append(hypothesis.prior)
    logs = np.cumsum(evidences, axis=1) + np.log(priors)[:, np.newaxis]
    shares = np.exp(logs - logs.max(axis=0))
    shares /= shares.sum(axis=0)
    means, covs = (np.array(part) for part in zip(*found, strict=True))
    mean = np.einsum("jk,jka->ka", shares, means)
    off = means - mean
    cov = np.einsum("jk,jkab->kab", shares, covs + off[..., :, None] * off[..., None, :])
    weights: dict[str, float] = {}
    for hypothesis, share in zip(hypotheses, shares[:, -1], strict=True):
        weights[hypothesis.kind] = weights.get(hypothesis.kind, 0.0) + float(share)
    return mean, cov, weights


def _filtered(
    problem: Problem, hypothesis: Hypothesis, iterations: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return means and covariances of the problem's states and the evidence (K,)."""
    n, larger = problem.dimension, _enlarged(problem, hypothesis)
    loss, threshold = hypothesis.loss, hypothesis.threshold
    iterations = iterations if loss == "none" else max(iterations, 2)
    x, cov = larger.prior_mean, larger.prior_cov
    means, covs, evidence = [], [], []
    total = quad(lambda r: math.exp(-losses(np.array(r), loss, threshold)), -np.inf, np.inf)[0]
    for k in range(problem.epochs):
        phi, noise = larger.transition[k], larger.noise_of(k)
        x, cov = phi @ x, phi @ cov @ phi.T + larger.process_cov[k]
        update = Update(
            problem=larger,
            k=k,
            predicted=x,
            cov=cov,
            noise_cov=noise,
            loss=loss,
            threshold=threshold,
        )
        innovation, spread = update.innovation()
        s = spread + noise
        cost = 0.5 * innovation @ np.linalg.solve(s, innovation)
        if iterations > 1:
            update.minimise(iterations)
            innovation, spread = update.innovation()
            cost = update._cost(update.dual, update.h)
        s, whole = spread + update.noise_cov, update.noise_cov
        ratio = np.linalg.slogdet(s).logabsdet - np.linalg.slogdet(whole).logabsdet
        there = problem.present[k]
        given = np.linalg.slogdet(noise[np.ix_(there, there)]).logabsdet
        peak = there.sum() * math.log(total / math.sqrt(2.0 * math.pi))
        evidence.append(-cost - 0.5 * ratio - 0.5 * given - peak)
        x, cov = update.corrected(iterated=iterations > 1)
        means.append(x[:n])
        covs.append(cov[:n, :n])
    return np.array(means), np.array(covs), np.array(evidence)


@dataclass
class _Disturbed:
    """The measurement model of a problem, with errors (m, a) of its channels as further states."""

    model: MeasurementModel
    effect: np.ndarray
    present: np.ndarray

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        a = self.effect.shape[1]
        own, added = x[: len(x) - a], x[len(x) - a :]
        return self.model.predict(k, own) + self.present[k] * (self.effect @ added)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        own = self.model.jacobian(k, x[: len(x) - self.effect.shape[1]])
        return np.hstack([own, self.present[k][:, np.newaxis] * self.effect])


def _enlarged(problem: Problem, hypothesis: Hypothesis) -> Problem:
    """Return the problem with the states of a hypothesis behind its own."""
    m, n = problem.measurements.shape[1], problem.dimension
    gradients = [i for i, channel in enumerate(problem.channels) if channel.unit == "E"]
    errors = np.eye(m)[:, gradients]
    factors = np.where(errors.any(axis=1), hypothesis.noise, 1.0)
    # Processes of each error: drift and stationary covariance of what follows (metres as time).
    parts: list[tuple[np.ndarray, np.ndarray, bool]] = []
    effects = [np.zeros((m, 0))]
    if hypothesis.wander:
        variance, length = hypothesis.wander**2, hypothesis.length_m
        for column in errors.T:
            if hypothesis.rough:
                parts.append((np.array([[-1.0 / length]]), np.array([[variance]]), True))
                effects.append(column[:, np.newaxis])
            else:
                rate = math.sqrt(3.0) / length
                drift = np.array([[0.0, 1.0], [-(rate**2), -2.0 * rate]])
                parts.append((drift, np.diag([variance, rate**2 * variance]), True))
                effects.append(np.column_stack([column, np.zeros(m)]))
    gravity = sum(len(part[0]) for part in parts)
    if hypothesis.gravity_mgal:
        rate = 0.0 if hypothesis.integrated else 1.0 / (1e3 * hypothesis.gravity_km)
        size = (hypothesis.gravity_mgal * MGAL) ** 2
        for _ in range(3):
            parts.append((np.array([[-rate]]), np.array([[size]]), True))
            effects.append(np.zeros((m, 1)))
    if hypothesis.integrated:
        parts.append((np.zeros((1, 1)), np.array([[1e-12]]), True))
        effects.append(np.zeros((m, 1)))
    if hypothesis.constant:
        for column in errors.T:
            parts.append((np.zeros((1, 1)), np.array([[hypothesis.constant**2]]), False))
            effects.append(column[:, np.newaxis])
    effect = np.hstack(effects)
    added, epochs = effect.shape[1], problem.epochs
    phi, q = np.zeros((epochs, n + added, n + added)), np.zeros((epochs, n + added, n + added))
    prior = block_diag(problem.prior_cov, *(part[1] for part in parts))
    mean = np.concatenate([problem.prior_mean, np.zeros(added)])
    if hypothesis.integrated:
        mean[n + gravity + 3] = 1.0
    change = np.zeros((epochs + 1, 3))
    if hypothesis.integrated:
        change[1:] = _walk(problem, gradients)
    for k in range(epochs):
        step = problem.times[k] - (problem.times[k - 1] if k else 0.0)
        way = 0.0
        if problem.track is not None:
            way = step * float(np.linalg.norm(problem.track.velocities[k]))
        moves = [expm(drift * way) for drift, _, _ in parts]
        noises = [cov - f @ cov @ f.T for f, (_, cov, _) in zip(moves, parts, strict=True)]
        phi[k] = block_diag(problem.transition[k], *moves)
        q[k] = block_diag(problem.process_cov[k], *noises)
        if hypothesis.gravity_mgal:
            assert problem.track is not None
            place = next(b.slice for b in problem.layout if b.name == "accelerometer bias")
            felt = problem.transition[k][:, place] @ problem.track.attitudes[k].T
            felt[place] = 0.0
            columns = slice(n + gravity, n + gravity + 3)
            phi[k, :n, columns] = felt
            if hypothesis.integrated:
                phi[k, :n, columns.stop] = felt @ (0.5 * (change[k] + change[k + 1]))
                sigma = 1e-9 * hypothesis.noise * math.sqrt(problem.noise_of(k)[0, 0])
                before = problem.track.velocities[max(k - 1, 0)]
                speed = np.linalg.norm(0.5 * (before + problem.track.velocities[k]))
                for i in range(columns.start, columns.stop):
                    q[k, i, i] = (sigma * step * speed) ** 2
    return dataclasses.replace(
        problem,
        noise_cov=problem.noise_cov * np.outer(factors, factors),
        transition=phi,
        process_cov=q,
        prior_mean=mean,
        prior_cov=prior,
        model=_Disturbed(problem.model, effect, problem.present),
        replay=None,
    )


def _walk(problem: Problem, gradients: list[int]) -> np.ndarray:
    """Return −∫ T v dt (K, 3) [m/s²] of tensors that are read in axes ENU, xx to zz in order."""
    assert problem.track is not None
    names = [problem.channels[i].name for i in gradients]
    track, total, out = problem.track, np.zeros(3), np.zeros((problem.epochs, 3))
    last = None
    for k in range(problem.epochs):
        latitude, _, height = track.positions[k]
        ee, nn, nu, uu = normal_gradient_of(math.sin(latitude), math.cos(latitude), height)
        normal = {"xx": ee, "yy": nn, "yz": nu, "zz": uu}
        values = {}
        for i, name in zip(gradients, names, strict=True):
            key = name[-2:]
            values[key] = problem.measurements[k, i] - normal.get(key, 0.0)
        trace = (values["xx"] + values["yy"] + values.get("zz", 0.0)) / 3.0
        if "zz" in values:  # the trace is zero: least squares share what it reads as
            for key in ("xx", "yy", "zz"):
                values[key] -= trace
        else:
            values["zz"] = -values["xx"] - values["yy"]
        t = 1e-9 * np.array(
            [
                [values["xx"], values["xy"], values["xz"]],
                [values["xy"], values["yy"], values["yz"]],
                [values["xz"], values["yz"], values["zz"]],
            ]
        )
        if last is None:
            last = t
        step = problem.times[k] - (problem.times[k - 1] if k else 0.0)
        velocity = 0.5 * (track.velocities[max(k - 1, 0)] + track.velocities[k])
        east, north, _ = velocity / 6.371e6
        turn = np.array([-north, east, east * math.tan(latitude)])
        total = total - step * (0.5 * (last + t) @ velocity + np.cross(turn, total))
        last, out[k] = t, total
    return out
