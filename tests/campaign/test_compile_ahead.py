"""Processes that compile ahead: they compile what a flight uses, and end with their parent."""

import subprocess
import sys
import textwrap

import psutil
import pytest

from ggbench.campaign.compile_ahead import compile_estimators, compiling_ahead

COMPARE = textwrap.dedent("""
    import numpy as np
    from ggbench.campaign.compile_ahead import compile_estimators
    from ggbench.campaign import registry
    from ggbench.contract.catalogue import flight
    from ggbench.engines import filters, whitened_measurements
    from ggbench.sensors import model_kernels

    def compiled():
        return {
            (module.__name__, name): set(value.signatures)
            for module in (filters, whitened_measurements, model_kernels)
            for name, value in vars(module).items() if hasattr(value, "signatures")
        }

    before = compiled()
    compile_estimators(["ekf"])
    ahead = compiled()
    registry.choose("ekf").estimator.estimate(flight(), np.random.default_rng(0))
    assert before != ahead
    assert compiled() == ahead
""")


@pytest.mark.long
def test_a_flight_has_nothing_left_to_compile():
    """The filter and the measurement model have the same types on a flight as ahead of it."""
    subprocess.run([sys.executable, "-c", COMPARE], check=True, timeout=300)


def test_an_estimator_that_cannot_be_made_is_passed_over():
    """What is wrong with it is said where it flies."""
    compile_estimators(["no-such-estimator", "ekf[iterations=-1]"])


def test_the_process_ends_with_its_context():
    """Nothing runs on after a command, whatever it was at."""
    before = psutil.Process().children()
    with compiling_ahead(first=True) as compile_them:
        compile_them(["ekf"])
        (process,) = set(psutil.Process().children()) - set(before)
    assert not process.is_running()
    for context in (compiling_ahead(first=False), compiling_ahead(True, 1)):
        with context as compile_them:
            compile_them(["ekf"])
            assert set(psutil.Process().children()) <= set(before)


@pytest.mark.long
def test_the_process_ends_with_its_parent():
    """A command that is killed leaves no compiler behind."""
    script = (
        "from ggbench.campaign.compile_ahead import compiling_ahead\n"
        "import psutil, time\n"
        "with compiling_ahead(first=True):\n"
        "    print(psutil.Process().children()[0].pid, flush=True)\n"
        "    time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout
    child = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    _gone, alive = psutil.wait_procs([child], timeout=60)
    assert not alive
