# %% [markdown]
# # First steps: from a scenario to a figure
#
# This script consists of notebook cells. Jupyter (with jupytext), VS Code and Spyder open it as a
# notebook. `python docs/examples/first_steps.py` runs it as a script.

# %%
import ggbench as gg

scenario = gg.load("wang2013")
case = scenario.case("0.01E-1Hz")

# %% [markdown]
# Simulate one run. The estimator receives only the problem. The truth serves to judge the estimate.

# %%
problem, truth = gg.simulate(case, seed=1, run=0)
estimate = gg.estimate(problem, "ukf[points=merwe]")
print(problem)
print(gg.judge(problem, estimate, truth, case.windows))

# %% [markdown]
# Fly several runs in worker processes, as `ggbench run` does. With `output="results/mine"` the runs
# are stored, and the same call continues an interrupted campaign. `gg.Results("results/mine")`
# opens stored runs.

# %%
results = gg.run(scenario, ["ins", "ekf"], runs=5, cases=[case.name])
metrics = results.metrics()
settled = metrics[metrics["window"] == "settled"]
print(settled[["estimator", "rms_m", "velocity_rms_mps", "efficiency", "success"]])

# %% [markdown]
# Every figure is a Matplotlib figure. A notebook shows it if it is the last line of a cell.

# %%
figure = results.plot_error_over_time(case.name)
figure.savefig("error_over_time.png")
