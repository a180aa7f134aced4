"""How the tables of a file become cases: what is laid over what, and what replaces what."""

from __future__ import annotations

import math
import tomllib

import pytest
from problems import SMALL
from small_cases import ROTATING, small_case

from ggbench.errors import GGBenchError
from ggbench.spec import scenario
from ggbench.spec.scenario import Scenario, ScenarioError
from ggbench.spec.segments import SegmentSpec
from ggbench.trajectory.manoeuvres import Cruise
from ggbench.trajectory.truth import Segment
from ggbench.trajectory.waypoints import Waypoint

DENSITY = "noise_density_eotvos_per_sqrt_hz"
DISKS = "rotating.accelerometer_noise_ng_per_sqrt_hz"


def loaded(text: str) -> Scenario:
    return scenario.parse(tomllib.loads(text), "small", "small")


def with_case(*lines: str) -> Scenario:
    """The small scenario with one more case."""
    return loaded(SMALL + '\n[[case]]\nname = "third"\ntitle = "x"\n' + "\n".join(lines))


def noises(gradiometer) -> tuple[float | None, float | None, float | None]:
    disks = gradiometer.rotating
    return (
        gradiometer.noise_eotvos,
        getattr(gradiometer, DENSITY),
        disks.accelerometer_noise_ng_per_sqrt_hz if disks else None,
    )


def test_one_way_to_state_the_noise_replaces_the_others():
    """A case that states its noise in another way than the base has that one alone."""
    assert noises(with_case(f"gradiometer.{DENSITY} = 0.2").case("third").gradiometer) == (
        None,
        0.2,
        None,
    )
    disks = "gradiometer.rotating = { baseline_m = 0.5, rotation_hz = 0.5"
    third = with_case(f"{disks}, accelerometer_noise_ng_per_sqrt_hz = 2.0 }}").case("third")
    assert noises(third.gradiometer) == (None, None, 2.0)
    text = SMALL.replace(
        "noise_eotvos = 0.01\n",
        "rotating = { baseline_m = 0.5, rotation_hz = 0.5, "
        "accelerometer_noise_ng_per_sqrt_hz = 2.0 }\n",
        1,
    )
    assert noises(loaded(text).case("base").gradiometer) == (None, None, 2.0)
    assert noises(loaded(text).case("noisy").gradiometer) == (0.1, None, None)
    with pytest.raises(ScenarioError, match="give exactly one of noise_eotvos"):
        with_case("gradiometer.noise_eotvos = 0.2", f"gradiometer.{DENSITY} = 0.2")


@pytest.mark.parametrize("side", ["truth", "model"])
def test_one_side_may_state_its_noise_in_another_way(side):
    """Over the base's noise, whatever its form; the other side keeps the base's."""
    other = "model" if side == "truth" else "truth"
    for base, own in (({}, (0.01, None, None)), (ROTATING, (None, None, 1.0))):
        for key, wanted in (("noise_eotvos", (0.5, None, None)), (DENSITY, (None, 0.5, None))):
            case = small_case(base | {f"{side}.gradiometer.{key}": 0.5})
            assert noises(case.side(side).gradiometer) == wanted
            assert noises(case.side(other).gradiometer) == own


def test_what_a_side_changes_is_laid_over_the_base():
    """Its keys are the side's, all others are the base's; the base itself stays what it is."""
    case = small_case(
        {
            "truth.imu.gyro_bias_deg_per_h": 9.0,
            "model.initial_error.position_m": 70.0,
            "truth.gradiometer.bias_eotvos": 3.0,
        }
    )
    truth, model = case.side("truth"), case.side("model")
    assert (truth.imu.gyro_bias_deg_per_h, model.imu.gyro_bias_deg_per_h) == (9.0, 0.015)
    assert truth.imu.gyro_noise_deg_per_sqrt_h == model.imu.gyro_noise_deg_per_sqrt_h == 0.005
    assert (truth.initial_error.position_m, model.initial_error.position_m) == (5.0, 70.0)
    assert (truth.gradiometer.bias_eotvos, model.gradiometer.bias_eotvos) == (3.0, 0.0)
    assert case.imu.gyro_bias_deg_per_h == 0.015


def test_a_study_is_laid_over_the_cases_with_published_numbers():
    """Over what the case itself says, too; a case without published numbers is not studied."""
    study = '\n[[assumption]]\nname = "s"\ntitle = "t"\ngradiometer.noise_eotvos = 0.03\n'
    reference = '"value" = 1.0, provenance = "paper: none" }\n'
    text = SMALL + study
    assert [case.name for case in loaded(text).assumptions[0].cases] == ["base"]
    published = text.replace(
        "gradiometer.noise_eotvos = 0.1",
        "gradiometer.noise_eotvos = 0.1\n"
        f"reference.position_mrse_m = {{ {reference}reference.velocity_mrse_mps = {{ {reference}",
    )
    (assumption,) = loaded(published).assumptions
    assert [case.name for case in assumption.cases] == ["base", "noisy"]
    assert {case.gradiometer.noise_eotvos for case in assumption.cases} == {0.03}
    assert loaded(published).case("noisy").gradiometer.noise_eotvos == 0.1


LIMITS = {
    "time constant of a gyro bias": (
        {"imu.gyro_bias_time_s": 1.0},
        {"imu.gyro_bias_time_s": 0.99},
        "at least 10 times",
    ),
    "time constant of the altimeter": (
        {"altimeter": {"noise_m_per_sqrt_hz": 1.0, "time_constant_s": 1.0}},
        {"altimeter": {"noise_m_per_sqrt_hz": 1.0, "time_constant_s": 1.0}, "imu.period_s": 0.2},
        "at least 10 times",
    ),
    "a gap in the readings": (
        {"truth.gradiometer.dropouts_s": [[3.0, 3.5]]},
        {"truth.gradiometer.dropouts_s": [[3.0, 3.0]]},
        "from < to",
    ),
    "two readings": ({"gradiometer.period_s": 10.0}, {"gradiometer.period_s": 10.1}, "too short"),
    "the settled window": (
        {"gradiometer.period_s": 3.0, "windows.settled_from_s": 18.0},
        {"gradiometer.period_s": 3.0, "windows.settled_from_s": 18.1},
        "the last reading, at 18 s",
    ),
    "a disturbance that is felt": (
        {"truth.field.source": "x.nc", "truth.field.gravity_disturbance": True},
        {"model.field.source": "x.nc", "truth.field.gravity_disturbance": True},
        "needs a map",
    ),
    "a disturbance that is compensated": (
        {"field.source": "x.nc", "field.gravity_disturbance": True, "model.field.compensate": True},
        {"field.source": "x.nc", "model.field.compensate": True},
        "accelerometers measure none",
    ),
    "a map to compensate from": (
        {"field.source": "x.nc", "field.gravity_disturbance": True, "model.field.compensate": True},
        {
            "truth.field.source": "x.nc",
            "truth.field.gravity_disturbance": True,
            "model.field.source": "normal",
            "model.field.compensate": True,
        },
        "has no gravity dist",
    ),
    "readings of a filter": (
        {"truth.gradiometer.dropout_share": 0.1},
        {"truth.gradiometer.dropout_share": 0.1, "gradiometer.filter": "butterworth"},
        "without a filter",
    ),
    "the cut-off": (
        {"gradiometer.filter": "butterworth", "gradiometer.filter_cutoff_hz": 0.49},
        {"gradiometer.filter": "butterworth", "gradiometer.filter_cutoff_hz": 0.5},
        "Nyquist",
    ),
    "outliers": (
        {"truth.gradiometer.outlier_share": 0.1, "truth.gradiometer.outlier_eotvos": 3.0},
        {"truth.gradiometer.outlier_share": 0.1},
        "must be given together",
    ),
    "the clock": (
        {"truth.gradiometer.clock_error_s": 0.1},
        {"truth.gradiometer.clock_error_s": 0.1, "gradiometer.instrument": "strapdown"},
        "requires instrument =",
    ),
}


@pytest.mark.parametrize("rule", LIMITS)
def test_rules_end_where_they_say(rule):
    """What just keeps a rule is a case, what just breaks it has its sentence."""
    kept, broken, sentence = LIMITS[rule]
    small_case(kept)
    with pytest.raises(GGBenchError, match=sentence):
        small_case(broken)


def test_everything_that_changes_a_result_changes_the_hash():
    """Truth, model, windows, instruments; not the name, the title or the published numbers."""
    plain = small_case()
    changes = (
        {"truth.imu.gyro_bias_deg_per_h": 9.0},
        {"model.imu.gyro_bias_deg_per_h": 9.0},
        {"truth.gradiometer.outlier_share": 0.1, "truth.gradiometer.outlier_eotvos": 3.0},
        {"windows.last_s": 4.0},
        {"windows.required_m": 9.0},
        {"trajectory.repeat": 2},
        {"altimeter.noise_m_per_sqrt_hz": 1.0},
        {"initial_error.height_m": 9.0},
        {"imu.biases": "fixed"},
        {"field.source": "x.nc"},
        {"gradiometer.components": ["xx"]},
    )
    hashes = [small_case(change).content_hash for change in changes]
    assert len({plain.content_hash, *hashes}) == 1 + len(changes)
    renamed = plain.model_copy(update={"name": "n", "title": "t", "reference": None})
    assert renamed.content_hash == plain.content_hash


def test_manoeuvres_are_in_si_units():
    """Degrees become radians, kilometres metres; right is positive."""

    def made(**keys: object) -> object:
        return SegmentSpec.model_validate(keys).manoeuvre()

    rates = {"turn_rate_deg_per_s": 3.0, "acceleration_mps2": 2.0, "climb_rate_deg_per_s": -1.5}
    assert made(duration_s=7.0, **rates) == Segment(7.0, math.radians(3), 2.0, math.radians(-1.5))
    assert made(kind="cruise", distance_km=12.0) == Cruise(12_000.0)
    turn = {"kind": "turn", "turn_rate_deg_per_s": 3.0, "to_heading_deg": 40.0}
    assert [
        list(vars(made(direction=way, **turn)).values()) for way in ("left", "right", "shorter")
    ] == [[None, math.radians(40), sign, None, math.radians(3), None] for sign in (-1, 1, 0)]
    place = {"latitude_deg": 48.0, "longitude_deg": 11.0, "bank_deg": 20.0}
    assert made(kind="waypoint", **place) == Waypoint(
        *map(math.radians, (48.0, 11.0)), bank=math.radians(20.0)
    )
    climb = made(kind="climb", to_height_m=900.0, climb_angle_deg=6.0)
    assert list(vars(climb).values()) == [None, 900.0, math.radians(6), None, 2.0]
    terrain = {"kind": "terrain-following", "terrain": "x.nc", "clearance_m": 90.0}
    follow = made(distance_km=3.0, max_climb_angle_deg=8.0, lowest_m=200.0, **terrain)
    assert list(vars(follow).values()) == [
        "x.nc",
        90.0,
        200.0,
        None,
        3000.0,
        math.radians(8),
        2.0,
        0.0,
    ]
    assert made(duration_s=9.0, **terrain).lowest == -math.inf


def test_repeated_segments_last_as_often_as_long():
    """The whole sequence is flown so many times."""
    assert small_case({"trajectory.repeat": 3}).trajectory.duration_s == 60.0
