"""Python interface: every name is available as ``gg.NAME`` after ``import ggbench as gg``.

    scenario = gg.load("wang2013")
    problem, truth = gg.simulate(scenario.case("0.01E-1Hz"), seed=1, run=0)
    estimate = gg.estimate(problem, "ukf[points=merwe]")
    gg.judge(problem, estimate, truth)
    gg.run(scenario, ["ins", "ekf"], runs=20).metrics()
    problem, reference = gg.read_flight("flight.toml")
    gg.corrected(problem, gg.estimate(problem, "ekf"))

User errors raise :class:`~ggbench.errors.GGBenchError`, whose message is one sentence.
"""
