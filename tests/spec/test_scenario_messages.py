"""Messages of scenario files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from problems import SMALL
from scenario_files import load_and_fly, small
from thinning import thinned

from ggbench.errors import GGBenchError
from ggbench.spec import scenario
from ggbench.spec.flight import load as load_flight
from ggbench.spec.scenario import ScenarioError

NOISE = "noise_eotvos = 0.01"
CASE = '[[case]]\nname = "noisy"'
EGM = 'source = "egm2008_qinling"\nlowest_m = 9000.0\nhighest_m = 11000.0\n'
GRADIOMETER = "[gradiometer]"
BAD = {
    "unknown key": (
        NOISE, NOISE + "\nnoise_eotovs = 1.0",
        r"case 'base'.*unknown key 'gradiometer.noise_eotovs' \(did you mean 'noise_eotvos'\?\)",
    ),
    "unknown table": (
        "[windows]", "[window]\nlast_s = 1.0\n[windows]",
        r"unknown key 'window' \(did you mean 'windows'\?\); known: name, title, trajectory",
    ),
    "unknown campaign key": (
        "[campaign]", "[campaign]\nrun = 3",
        r"campaign: unknown key 'run' \(did you mean 'runs'\?\)",
    ),
    "unit in a value": (
        NOISE, 'noise_eotvos = "0.01 E"',
        r"gradiometer.noise_eotvos is '0.01 E' and must be a plain number in the unit",
    ),
    "unit in a value with provenance": (
        NOISE, 'noise_eotvos = { value = "0.01 E", provenance = "paper" }',
        r"gradiometer.noise_eotvos is '0.01 E' and must be a plain number in the unit",
    ),
    "bool for a number": (
        NOISE, "noise_eotvos = true",
        r"gradiometer.noise_eotvos is True and must be a plain number",
    ),
    "list for a number": (
        NOISE, "noise_eotvos = [0.01]",
        r"gradiometer.noise_eotvos is \[0.01\] and must be a plain number",
    ),
    "number for a table": (CASE, CASE + "\nimu = 3", r"case 'noisy': imu is 3 and must be"),
    "NaN": (NOISE, "noise_eotvos = nan", r"gradiometer.noise_eotvos is not a number"),
    "infinity": (NOISE, "noise_eotvos = inf", r"gradiometer.noise_eotvos is inf and must lie"),
    "NaN elsewhere": (
        "heading_deg = 90.0", "heading_deg = nan", r"trajectory.heading_deg is not a number",
    ),
    "negative noise": (
        NOISE, "noise_eotvos = -0.01",
        r"gradiometer.noise_eotvos is -0.01 and must lie between 1e-9 and 1e6",
    ),
    "no noise at all": (NOISE, "noise_eotvos = 0.0", r"noise_eotvos is 0.0 and must lie between"),
    "negative gyro noise": (
        "gyro_noise_deg_per_sqrt_h = 0.005", "gyro_noise_deg_per_sqrt_h = -1.0",
        r"imu.gyro_noise_deg_per_sqrt_h is -1.0 and must be 0 or lie between 1e-9 and 3600",
    ),
    "both kinds of noise": (
        NOISE, NOISE + "\nnoise_density_eotvos_per_sqrt_hz = 0.01",
        r"gradiometer: give exactly one of noise_eotvos .* noise_density_eotvos_per_sqrt_hz",
    ),
    "neither kind of noise": (NOISE, "", r"gradiometer: give exactly one of noise_eotvos"),
    "cut-off at Nyquist": (
        NOISE, NOISE + '\nfilter = "butterworth"\nfilter_cutoff_hz = 0.5',
        r"filter_cutoff_hz is 0.5 Hz and must lie below the Nyquist frequency .*0.5 Hz",
    ),
    "unknown filter": (
        NOISE, NOISE + '\nfilter = "chebyshev"',
        r"gradiometer.filter is 'chebyshev' and must be 'butterworth' or 'none'",
    ),
    "period no multiple": (
        "period_s = 1.0", "period_s = 0.25",
        r"gradiometer.period_s \(0.25 s\) must be a whole multiple of imu.period_s \(0.1 s\)",
    ),
    "flight too short": ("duration_s = 20.0", "duration_s = 1.0", r"the flight lasts 1 s"),
    "window beyond the flight": (
        "settled_from_s = 10.0", "settled_from_s = 21.0",
        r"windows.settled_from_s is 21 s and must not lie beyond the last reading, at 20 s",
    ),
    "latitude beyond the pole": (
        "latitude_deg = 33.5", "latitude_deg = 133.5", r"trajectory.latitude_deg is 133.5 and must",
    ),
    "speed of a meteor": ("speed_mps = 250.0", "speed_mps = 1e300", r"speed_mps"),
    "unknown map source": (
        'source = "normal"', 'source = "egm2088"', r"(?i)source 'egm2088'.*egm2008_qinling",
    ),
    "map beside the flight": (
        'source = "normal"',
        EGM + "south_deg = 33.3\nnorth_deg = 33.7\nwest_deg = 109.0\neast_deg = 109.4",
        r"position 33.50000° N, 108.0.* is outside the gradient map, which covers 33.300° to",
    ),
    "map outside its source": (
        'source = "normal"',
        EGM + "south_deg = 0.0\nnorth_deg = 1.0\nwest_deg = 108.0\neast_deg = 109.0",
        r"south_deg.* 0.0 .*28.5 to 38.5",
    ),
    "duplicate case": (CASE, '[[case]]\nname = "base"', r"case 'base' is defined twice"),
    "case named like a path": (CASE, '[[case]]\nname = "../x"', r"name is '../x' and"),
    "case without a name": (CASE, "[[case]]", r"'name' is missing"),
    "one case as a table": (
        SMALL[SMALL.index("[[case]]") :], '[case]\nname = "x"', r"'case' must be written as \[\[",
    ),
    "no case": (SMALL[SMALL.index("[[case]]") :], "", r"has no \[\[case\]\]"),
    "missing section": ("[windows]\nsettled_from_s = 10.0\nlast_s = 5.0", "", r"'windows' is miss"),
    "missing key": ("last_s = 5.0", "", r"'windows.last_s' is missing"),
    "missing title": ('title = "A short', 'titel = "A short', r"needs a text 'title'"),
    "assumption without a title": (
        "[[case]]", '[[assumption]]\nname = "a"\n[[case]]', r"assumption 'a': needs a name and",
    ),
    "unknown key in an assumption": (
        "[[case]]", '[[assumption]]\nname = "a"\ntitle = "b"\nimu.noise = 1.0\n[[case]]',
        r"assumption 'a', case 'base': unknown key 'imu.noise'",
    ),
    "value without provenance": (
        NOISE, "noise_eotvos = { value = 0.01 }", r"gradiometer.noise_eotvos: a value with prov",
    ),
    "no estimators": ('estimators = ["ins", "ekf"]', "estimators = []", r"estimators is \[\] and"),
    "no runs": ("[campaign]", "[campaign]\nruns = 0", r"campaign: runs is 0 and must be greater"),
    "negative seed": ("[campaign]", "[campaign]\nseed = -1", r"campaign: seed is -1 and must be"),
    "invalid TOML": ("[windows]", "[windows", r"is not valid TOML: .*line 3\d"),
    "true error as a common one": (
        "[imu]", "[imu]\ngyro_scale_factor_ppm = 100.0",
        r"unknown key 'imu.gyro_scale_factor_ppm'; known: grade, period_s, ",
    ),
    "outliers in the model": (
        GRADIOMETER, f"[model.gradiometer]\noutlier_share = 0.1\n{GRADIOMETER}",
        r"unknown key 'model.gradiometer.outlier_share'; known: noise_eotvos, ",
    ),
    "another period in the truth": (
        GRADIOMETER, f"[truth.gradiometer]\nperiod_s = 2.0\n{GRADIOMETER}",
        r"unknown key 'truth.gradiometer.period_s'.*; known: ",
    ),
    "unknown table of the truth": (
        GRADIOMETER, f"[truth.imus]\n{GRADIOMETER}",
        r"unknown key 'truth.imus' \(did you mean 'imu'\?\); known: imu, gradiometer, field, init",
    ),
    "gravity felt by the model": (
        GRADIOMETER, f"[model.field]\ngravity_disturbance = true\n{GRADIOMETER}",
        r"unknown key 'model.field.gravity_disturbance'",
    ),
    "outliers without a size": (
        GRADIOMETER, f"[truth.gradiometer]\noutlier_share = 0.1\n{GRADIOMETER}",
        r"truth.gradiometer: outlier_share and outlier_eotvos must be given together",
    ),
    "all outliers": (
        GRADIOMETER, f"[truth.gradiometer]\noutlier_share = 1.0\n{GRADIOMETER}",
        r"truth.gradiometer.outlier_share is 1.0 and must be 0 or lie between",
    ),
    "a dropout that ends before it begins": (
        GRADIOMETER, f"[truth.gradiometer]\ndropouts_s = [[5.0, 4.0]]\n{GRADIOMETER}",
        r"truth.gradiometer: dropouts_s must be \[from, to\] with from < to, found \[5, 4\]",
    ),
    "a dropout without an end": (
        GRADIOMETER, f"[truth.gradiometer]\ndropouts_s = [[5.0]]\n{GRADIOMETER}",
        r"truth.gradiometer.dropouts_s\[0\] is \[5.0\] and",
    ),
    "dropouts behind a filter": (
        GRADIOMETER,
        f'[truth.gradiometer]\ndropout_share = 0.1\n{GRADIOMETER}\nfilter = "butterworth"',
        r"truth.gradiometer: measurements can be missing only without a filter",
    ),
    "both noises of the truth": (
        GRADIOMETER,
        "[truth.gradiometer]\nnoise_eotvos = 1.0\nnoise_density_eotvos_per_sqrt_hz = 1.0\n"
        + GRADIOMETER,
        r"truth.gradiometer: give exactly one of noise_eotvos",
    ),
    "fixed biases that wander in the truth": (
        "[imu]", '[truth.imu]\ngyro_bias_time_s = 9.0\n[imu]\nbiases = "fixed"',
        r'truth.imu: biases = "fixed" and a time constant of a bias exclude each other',
    ),
    "negative scale factor": (
        "[imu]", "[truth.imu]\ngyro_scale_factor_ppm = -1.0\n[imu]",
        r"truth.imu.gyro_scale_factor_ppm is -1.0 and must be 0 or lie between",
    ),
    "errors of disks that are not there": (
        GRADIOMETER, f"[truth.gradiometer.rotating]\nscale_factor_ppm = 1.0\n{GRADIOMETER}",
        r"truth.gradiometer.rotating requires a rotating gradiometer",
    ),
    "components of a rotating instrument": (
        GRADIOMETER,
        "[gradiometer.rotating]\nbaseline_m = 0.5\nrotation_hz = 0.5\n"
        f'{GRADIOMETER}\ncomponents = ["zz"]',
        r"gradiometer: components must not be given with \[gradiometer.rotating\]",
    ),
    "no whole number of half turns": (
        GRADIOMETER,
        f"[gradiometer.rotating]\nbaseline_m = 0.5\nrotation_hz = 0.3\n{GRADIOMETER}",
        r"gradiometer: rotating gradiometer: the measurement period of 1.0 s is 0.6 half turns",
    ),
    "an axis twice": (
        GRADIOMETER,
        '[gradiometer.rotating]\nbaseline_m = 0.5\nrotation_hz = 0.5\nspin_axes = ["x", "x"]\n'
        + GRADIOMETER,
        r"gradiometer.rotating.spin_axes: names an axis twice",
    ),
    "unknown mount": (
        GRADIOMETER, f'{GRADIOMETER}\ninstrument = "gimballed"',
        r"gradiometer.instrument is 'gimballed' and must be 'platform', 'local-level' or 'strapd",
    ),
    "unknown channel": (
        GRADIOMETER, f'{GRADIOMETER}\ncomponents = ["yx"]', r"gradiometer.components\[0\] is 'yx'",
    ),
    "an altimeter without noise": (
        GRADIOMETER, f"[altimeter]\nnoise_m_per_sqrt_hz = 0.0\n{GRADIOMETER}",
        r"altimeter.noise_m_per_sqrt_hz is 0.0 and must lie between 1e-6",
    ),
    "a damping faster than the INS": (
        "[imu]\nperiod_s = 0.1",
        "[altimeter]\nnoise_m_per_sqrt_hz = 1.0\ntime_constant_s = 1.5\n[imu]\nperiod_s = 0.2",
        r"altimeter.time_constant_s is 1.5 s and must be at least 10 times imu.period_s, 2 s",
    ),
    "a bias that wanders faster than it is read": (
        "[imu]", "[truth.imu]\ngyro_bias_time_s = 0.5\n[imu]",
        r"truth.imu: gyro_bias_time_s is 0.5 s and must be at least 10 times imu.period_s, 1 s",
    ),
    "an error of the normal field": (
        'source = "normal"', 'source = "normal"\nerror.density_factor = 1.1',
        r'field.error: source = "normal" has no map',
    ),
    "a map that is not there": (
        GRADIOMETER, f'[model.field]\nsource = "gone.nc"\n{GRADIOMETER}', r"gone.nc.*No such file",
    ),
}  # fmt: skip
"""Texts of the small scenario, what stands there instead, and messages."""


@pytest.mark.parametrize("kind", BAD)
def test_a_mistake_has_its_sentence(kind, tmp_path):
    """One line that names the key, what was found and what is allowed.

    It begins with the file's name wherever the file itself is wrong, and speaks no pydantic.
    """
    old, new, expected = BAD[kind]
    path = small(tmp_path, old, new)
    with pytest.raises(GGBenchError, match=expected) as caught:
        load_and_fly(path)
    message = str(caught.value)
    assert "\n" not in message
    assert not re.search(r"Input should|pydantic|Spec\b|Change\b|validation error", message)
    if isinstance(caught.value, ScenarioError):
        assert message.startswith(f"{path}: ")


def axis(name, values):
    numbers = ", ".join(map(str, values))
    return (
        f'\n[[sweep.axis]]\nname = "{name}"\nlabel = "x"\nvalues = [{numbers}]\n'
        'key = "trajectory.height_m"\n'
    )


CASES = "".join(f'[[case]]\nname = "c{n}"\ntitle = "t"\n' for n in range(10_001))
STUDIES = "".join(f'[[assumption]]\nname = "a{n}"\ntitle = "t"\n' for n in range(2))
BESIDE = "notes must name a file next to the scenario"
DEEP = "nested at most 16 deep"
BAD_FILES = {
    "bytes of UTF-16": (b"\xff\xfe\x00", "^PATH: is not UTF-8 text"),
    "Latin-1": ('title = "é"'.encode("latin-1"), "^PATH: is not UTF-8 text"),
    "an empty file": ("", "^PATH: needs a text 'title'"),
    "a zero byte": ("a = \x00", "^PATH: is not valid TOML"),
    "10003 cases": (SMALL + CASES, "has 10003 cases; at most 10000 are allowed"),
    "cases times assumptions": (
        SMALL + CASES[: CASES.index('[[case]]\nname = "c4000"')] + STUDIES,
        r"has 4002 cases × \(1 \+ 2 assumptions\) = 12006; at most 10000 are",
    ),
    "10002 grid points": (
        SMALL + axis("height", [1.0 + i for i in range(5001)]),
        "has 10002 grid points; at most 10000 are allowed",
    ),
    "an axis with a value twice": (SMALL + axis("x", [1.0, 1.0]), "must increase strictly"),
    "an axis that falls": (SMALL + axis("x", [2.0, 1.0]), "must increase strictly"),
    "notes of another folder": ('notes = "../notes.md"\n' + SMALL, BESIDE),
    "notes of the system": ('notes = "/etc/hostname"\n' + SMALL, BESIDE),
    "a number as notes": ("notes = 3\n" + SMALL, BESIDE),
    "notes that are not there": (
        'notes = "gone.md"\n' + SMALL,
        "small.toml: notes gone.md: cannot be read",
    ),
    "a key of 16 tables": (".".join("a" * 15) + f" = 1\n{SMALL}", "unknown key 'a'"),
    "no file": (None, "small.toml: cannot be read: No such file"),
    "a folder": (Path.mkdir, "small.toml: cannot be read: Is a directory"),
}
"""Contents of files, and messages."""


@pytest.mark.parametrize("kind", BAD_FILES)
def test_a_bad_file_has_its_sentence(kind, tmp_path):
    content, message = BAD_FILES[kind]
    path = tmp_path / "small.toml"
    if callable(content):
        content(path)
    elif content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ScenarioError, match=message.replace("PATH", re.escape(str(path)))) as info:
        scenario.load(str(path))
    assert "\n" not in str(info.value)


WITHOUT_MEASURE = {
    "a number of 5000 digits": ("x = " + "9" * 5000, "is not valid TOML: Exceeds the limit"),
    "a key of 3000 tables": (".".join("a" * 3000) + " = 1", DEEP),
    "40 lists": ("x = " + "[" * 40 + "]" * 40, DEEP),
    "5000 lists": ("x = " + "[" * 5000 + "]" * 5000, "is not valid TOML"),
    "3000 tables": ("x = " + "{a=" * 3000 + "1" + "}" * 3000, "is not valid TOML"),
}


@pytest.mark.parametrize("kind", WITHOUT_MEASURE)
@thinned("read", [scenario.load, lambda file: load_flight(Path(file))])
def test_toml_without_measure_is_refused(read, kind, tmp_path):
    """Of a scenario and of a recorded flight."""
    text, message = WITHOUT_MEASURE[kind]
    path = tmp_path / "deep.toml"
    path.write_text(f"{text}\n{SMALL}")
    with pytest.raises(GGBenchError, match=message) as info:
        read(str(path))
    assert "\n" not in str(info.value)


def test_an_unknown_name_is_followed_by_those_like_it():
    with pytest.raises(ScenarioError, match=r"'wang2012' \(did you mean 'wang2013'\?\)") as info:
        scenario.load("wang2012")
    assert "\n" not in str(info.value)
