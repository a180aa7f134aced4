"""Rotating-accelerometer disks on a mount, with random imperfections.

:mod:`.gradiometer.rotating` defines the signal and the imperfections of one disk. In this module
the imperfections of each disk are drawn once per run, and the motion is that of the flight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rotating import DISK_AXES, DISK_TENSOR, RotatingErrors, RotatingGradiometer, Vibration
from .rotating_budget import channel_errors

DISK_CHANNELS = {"x": ("yy-zz", "yz"), "y": ("zz-xx", "xz"), "z": ("xx-yy", "xy")}
"""The two channels of a disk by its spin axis, as :func:`.instrument.channel` names them,
in the order of :data:`ggbench.sensors.gradiometer.rotating.SPIN_CHANNELS`."""


@dataclass(frozen=True)
class SpinningDisks:
    """Disks that spin about axes of the mount, with random imperfections.

    The attributes of imperfections are standard deviations; values are drawn per disk and run.

    Attributes
    ----------
    instrument : baseline, spin rate and period, equal for all disks.
    spin_axes : spin axis of each disk: x, y or z of the mount.
    scale_factor : relative scale-factor error that all four accelerometers share.
    scale_factor_mismatch : relative scale-factor differences, within and between the pairs.
    baseline : relative error of the baseline.
    misalignment : differences in tilt of the sensitive axes, within and between the pairs [rad].
        The value applies to radial and to axial tilts.
    demodulation_phase : phase error of the demodulation [rad].
    rotation_rate : relative error of the spin rate.
    vibration : amplitudes of the specific force at one, two and three times the spin rate [m/s²].
        Each axis and frequency has a cosine and a sine amplitude.
    """

    instrument: RotatingGradiometer
    spin_axes: tuple[str, ...]
    scale_factor: float = 0.0
    scale_factor_mismatch: float = 0.0
    baseline: float = 0.0
    misalignment: float = 0.0
    demodulation_phase: float = 0.0
    rotation_rate: float = 0.0
    vibration: float = 0.0

    def errors(
        self,
        names: tuple[str, ...],
        tensors: np.ndarray,
        specific_forces: np.ndarray,
        angular_rates: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Return the channel errors (K, m) [E] from the random imperfections of a run.

        Parameters
        ----------
        names : names of the m channels.
        tensors : (K, 6) true tensors in the axes of the mount [E].
        specific_forces, angular_rates : (K, 3) means over each measurement, in the axes of the
            mount [m/s²], [rad/s].
        rng : random numbers of the imperfections.
        """
        out = np.zeros((len(tensors), len(names)))
        for axis in self.spin_axes:
            order = list(DISK_AXES[axis])
            added = channel_errors(
                self.instrument,
                self._draw(rng),
                tensors[:, list(DISK_TENSOR[axis])],
                specific_forces[:, order],
                angular_rates[:, order],
                Vibration(*(self.vibration * rng.standard_normal((2, 3, 3)))),
            )
            for column, name in zip(added.T, DISK_CHANNELS[axis], strict=True):
                out[:, names.index(name)] += column
        return out

    def _draw(self, rng: np.random.Generator) -> RotatingErrors:
        """Return the imperfections of one disk in one run."""
        mismatch = self.scale_factor_mismatch * rng.standard_normal(3)
        radial, axial = self.misalignment * rng.standard_normal((2, 3))
        common, baseline, phase, rate = rng.standard_normal(4)
        return RotatingErrors(
            scale_factor=float(self.scale_factor * common),
            scale_factor_pair12=float(mismatch[0]),
            scale_factor_pair34=float(mismatch[1]),
            scale_factor_between_pairs=float(mismatch[2]),
            baseline=float(self.baseline * baseline),
            radial_misalignment_pair12=float(radial[0]),
            radial_misalignment_pair34=float(radial[1]),
            radial_misalignment_between_pairs=float(radial[2]),
            axial_misalignment_pair12=float(axial[0]),
            axial_misalignment_pair34=float(axial[1]),
            axial_misalignment_between_pairs=float(axial[2]),
            demodulation_phase=float(self.demodulation_phase * phase),
            rotation_rate=float(self.rotation_rate * rate),
        )
