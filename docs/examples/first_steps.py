# %% [markdown]
# # First steps: from a scenario to a figure
#
# A script in cells: Jupyter (with jupytext), VS Code and Spyder open it as a notebook, and
# `python docs/examples/first_steps.py` runs it as it is.

# %%
import ggbench as gg

scenario = gg.load("wang2013")
case = scenario.case("0.01E-1Hz")

# %% [markdown]
# One run: a problem, which is all that an estimator may see, and the truth that it hides.

# %%
problem, truth = gg.simulate(case, seed=1, run=0)
estimate = gg.estimate(problem, "ukf[points=merwe]")
print(problem)
print(gg.judge(problem, estimate, truth, case.windows))

# %% [markdown]
# Many runs, in worker processes: the same that `ggbench run` does. With `output="results/mine"`
# they are kept, and the same call goes on where it was stopped; `gg.Results("results/mine")`
# opens them again.

# %%
results = gg.run(scenario, ["ins", "ekf"], runs=5, cases=[case.name])
metrics = results.metrics()
settled = metrics[metrics["window"] == "settled"]
print(settled[["estimator", "rms_m", "velocity_rms_mps", "efficiency", "success"]])

# %% [markdown]
# Every figure is a Matplotlib figure, which a notebook shows when it is a cell's last line.

# %%
figure = results.plot_error_over_time(case.name)
figure.savefig("error_over_time.png")
