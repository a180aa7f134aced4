"""Mounting angles of a gradiometer as states, for all kinds of mount.

A mount that is rotated from its assumed axes by angles α measures Rᵀ Γ R, with R = exp[α×] and the
tensor Γ in assumed axes. Let A be the rotation matrix from the assumed axes to ENU. The rotated
mount is then equal to a strapdown instrument with the attitude A R. Because A R = exp[(A α)×] A,
this instrument has the assumed attitude A and the attitude error A α.

The rotation errors of A itself are added to A α. They are the attitude error of the body
(strapdown), or the rotation of the local level with the position (platform). Products of these
errors with α are neglected. They are 0.01 E for α = 30′ and a rotation error of 3′ in a gradient of
3000 E. The effect of α alone is exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...gravity.ellipsoid import metres_along
from .instrument import PLATFORM, STRAPDOWN, inertial_from_local


@dataclass(frozen=True)
class Mount:
    """Mount of a gradiometer along INS tracks.

    Attributes
    ----------
    instrument : index of :data:`.instrument.INSTRUMENTS`.
    positions, times : (..., K, 3), (K,) positions [rad, rad, m] and times [s] of the measurements.
    attitudes : (..., K, 3, 3) C_nb at these times; needed for a strapdown instrument.
    rows : (..., K, 6, 15 or more) B_k, which maps the states to the errors of position, ENU [m],
        and attitude [rad] at these times.
    """

    instrument: int
    positions: np.ndarray
    times: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray


def with_mounting_angles(mount: Mount, first: int) -> Mount:
    """Convert any mount to a strapdown mount with mounting angles as states.

    The attitudes of the result are the rotations A from the assumed mount axes to ENU, see
    :mod:`.gradiometer.mounting`. The matrix B_k (``rows``) gets columns for the three angles [rad].

    Parameters
    ----------
    mount : mount without mounting angles.
    first : index of the first of the three states; 15 or more.
    """
    rows, columns = mount.rows, mount.rows.shape[-1]
    found = np.zeros((*rows.shape[:-1], first + 3))
    found[..., :3, :columns] = rows[..., :3, :]
    axes = np.broadcast_to(np.eye(3), (*mount.positions.shape, 3))
    if mount.instrument == STRAPDOWN:
        axes = mount.attitudes
        found[..., 3:, :columns] = rows[..., 3:, :]
    elif mount.instrument == PLATFORM:
        axes = np.swapaxes(inertial_from_local(mount.positions, mount.times), -1, -2)
        turns = _level_turns(np.ascontiguousarray(mount.positions.reshape(-1, 3)))
        found[..., 3:, :columns] = turns.reshape(axes.shape) @ rows[..., :3, :]
    found[..., 3:, first:] = axes
    return replace(mount, instrument=STRAPDOWN, attitudes=axes, rows=found)


def _level_turns(positions: np.ndarray) -> np.ndarray:
    """Return the Jacobian (N, 3, 3) of the local-level rotation to the position error [rad/m]."""
    east, north = metres_along(positions).T
    found = np.zeros((len(positions), 3, 3))
    found[:, 0, 1] = -1.0 / north
    found[:, 1, 0] = np.cos(positions[:, 0]) / east
    found[:, 2, 0] = np.sin(positions[:, 0]) / east
    return found
