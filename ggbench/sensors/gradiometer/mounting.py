"""Mounting angles of a gradiometer as states, for any mount.

A mount rotated about its assumed axes by angles α measures Rᵀ Γ R, R = exp[α×]. With A from the
assumed axes to ENU, it equals a strapdown instrument at the attitude A R, which is A with the
attitude error A α. Other rotations of A are added: the attitude error of the body (strapdown), or
the rotation of the local level with the position (platform). Products with α are neglected, 0.01 E
for 30′ and 3′ near 3000 E. The effect of α alone is exact.
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
    positions, times : (..., K, 3), (K,) of the measurements [rad, rad, m], [s].
    attitudes : (..., K, 3, 3) C_nb at these times, for a strapdown instrument.
    rows : (..., K, 6, 15 or more) B_k, from the states to the errors of position ENU [m] and
        attitude [rad] at these times.
    """

    instrument: int
    positions: np.ndarray
    times: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray


def with_mounting_angles(mount: Mount, first: int) -> Mount:
    """Return a mount as a strapdown mount with mounting angles as states.

    Its attitudes are A, and B_k has the columns of the three angles [rad].

    Parameters
    ----------
    mount : without mounting angles.
    first : the first of the three states; 15 or more.
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
    """Return how the local level turns (N, 3, 3) with a metre of position error [rad/m]."""
    east, north = metres_along(positions).T
    found = np.zeros((len(positions), 3, 3))
    found[:, 0, 1] = -1.0 / north
    found[:, 1, 0] = np.cos(positions[:, 0]) / east
    found[:, 2, 0] = np.sin(positions[:, 0]) / east
    return found
