"""Models that vary with time, at an epoch: as pyshtools reads them, and what is refused."""

from __future__ import annotations

import datetime
import shlex

import numpy as np
import pyshtools
import pytest
from click.testing import CliRunner

from ggbench.cli.main import main
from ggbench.gravity.gradient_map import MapError
from ggbench.maps.gravity_model import read_model

EPOCH = datetime.date(2024, 5, 1)
HEAD = """product_type gravity_field
modelname VARYING
earth_gravity_constant 0.3986004415D+15
radius 0.63781363E+07
max_degree 4
errors {errors}
norm fully_normalized
tide_system tide_free
{format}
end_of_head
"""
SIGMAS = " 1e-12 1e-12"


def text(intervals: bool = False, sigmas: str = SIGMAS, extra: str = "") -> str:
    """A model of degree 4 whose degrees 2 and 3 vary; of icgem2.0, in two intervals."""
    lines = []
    for n in range(5):
        for m in range(n + 1):
            c = {0: 1.0, 1: 0.0}.get(n, -4.84e-4 if (n, m) == (2, 0) else 1e-6 * (n + m / 10))
            s = 0.0 if m == 0 or n < 2 else -c
            value = f"{n} {m} {c:.12e} {s:.12e}{sigmas}"
            if n not in (2, 3):
                lines.append(f"gfc  {value}")
                continue
            change = f"{n} {m} 1.5d-10 {'2.5d-10' if m else '0.0'}{sigmas}"
            spans = ["20000101.0000 20200101.0000", "20200101.0000 20300101.0000"]
            for span in spans if intervals else [""]:
                start = span or "20100101"
                if span == spans[0] and not intervals:
                    continue
                lines += [
                    f"gfct {value} {start}",
                    f"trnd {change} {span}",
                    f"acos {change} {span} 1.0",
                    f"asin {change} {span} 1.0",
                    f"acos {change} {span} 0.5",
                ]
    head = HEAD.format(
        errors="formal" if sigmas else "no", format="format icgem2.0" if intervals else ""
    )
    return head + "\n".join(lines) + "\n" + extra


@pytest.mark.parametrize("sigmas", [SIGMAS, ""])
def test_an_epoch_is_that_of_pyshtools(tmp_path, sigmas):
    file = tmp_path / "model.gfc"
    file.write_text(text(sigmas=sigmas))
    expected, *_ = pyshtools.shio.read_icgem_gfc(str(file), epoch="20240501")
    found = read_model(file, epoch=EPOCH).coefficients
    np.testing.assert_allclose(found.cosine, expected[0], rtol=0.0, atol=1e-17)
    np.testing.assert_allclose(found.sine, expected[1], rtol=0.0, atol=1e-17)
    # Fourteen years of trend, and what the seasons add.
    assert found.cosine[3, 1] - 3.1e-6 == pytest.approx(1.5e-10 * 14.3, rel=0.15)


def test_of_several_intervals_that_of_the_epoch_counts(tmp_path):
    """Its t0 is where the trend begins: four years before the epoch."""
    file = tmp_path / "model.gfc"
    file.write_text(text(intervals=True))
    found = read_model(file, epoch=EPOCH).coefficients
    again = read_model(file, epoch=datetime.date(2004, 5, 1)).coefficients
    np.testing.assert_allclose(found.cosine, again.cosine, rtol=0.0, atol=1e-14)
    assert found.cosine[3, 1] - 3.1e-6 == pytest.approx(1.5e-10 * (4.3 - 0.5), rel=0.3)


BAD = {
    "no epoch": (text(), None, "vary with time .lines acos, asin, gfct, trnd.: give .* --epoch"),
    "an epoch of a static model": (
        "\n".join(
            line for line in text().splitlines() if line[:4] not in ("trnd", "acos", "asin")
        ).replace("gfct", "gfc "),
        EPOCH,
        "is constant in time",
    ),
    "outside": (text(intervals=True), datetime.date(1999, 1, 1), "no gfct line of degree"),
    "no gfct": (text(extra="trnd 4 1 1e-10 1e-10 0 0\n"), EPOCH, "trnd of .* no line gfct"),
    "twice": (text(extra="gfct 3 1 1e-10 1e-10 0 0 20100101\n"), EPOCH, "order 1 twice"),
    "no date": (text(extra="gfct 4 1 1e-10 1e-10 0 0\n"), EPOCH, "gfct 4 1 .* cannot be read"),
    "a word": (text(extra="trnd 4 one 1e-10 1e-10\n"), EPOCH, "trnd 4 one .* cannot be read"),
    "no period": (text(extra="acos 3 1 1e-10 1e-10 0 0 0\n"), EPOCH, "acos 3 1 .* cannot be re"),
    "gfc besides": (text(extra="gfc 3 1 1e-10 1e-10 0 0\n"), EPOCH, "degree 3 and order 1 more th"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_reduced_is_refused(name, tmp_path):
    content, epoch, expected = BAD[name]
    file = tmp_path / "model.gfc"
    file.write_text(content)
    with pytest.raises(MapError, match=expected):
        read_model(file, epoch=epoch)


def test_the_command_takes_an_epoch(tmp_path):
    """The map says for which day it holds; without the option it is not built."""
    file, out = tmp_path / "model.gfc", tmp_path / "map.nc"
    file.write_text(text())
    bounds = "--south 40 --north 41 --west 10 --east 11 --lowest 900000 --highest 1000000"
    command = [
        *("map", "build", "--coefficients", str(file), "-o", str(out)),
        *bounds.split(),
        *shlex.split("--spacing-arcmin 20 --height-spacing 25000"),
    ]
    failed = CliRunner().invoke(main, command)
    assert failed.exit_code == 2 and "--epoch" in failed.output
    built = CliRunner().invoke(main, [*command, "--epoch", "2024-05-01"])
    assert built.exit_code == 0, built.output
    shown = CliRunner().invoke(main, ["map", "show", str(out)]).output
    assert "VARYING at 2024-05-01" in shown and "--epoch 2024-05-01" in shown.replace("\n", " ")
