"""What the words and figures of all reports mean: one page beside them."""

from __future__ import annotations

import re
from pathlib import Path

from ..judging.ranking import LEAST_COVERAGE, MOST_FAILED, MOST_FALSE, UNCERTAIN
from ..judging.success import BOUNDS, EQUIVALENCE_RATIO, FEWEST, INS_FRACTION
from .tables import DEFINITIONS

_TEXT = """\
# Definitions

All reports of a folder use these words alike. Windows are named in each scenario; if nothing else
is said, figures are of the *settled* one.

**Error.** Spherical: the length of estimated less true position [m] or velocity [m/s]. A run's
error in a window is the root of its mean square over the epochs. *MRSE* is the root of the mean
square over runs and epochs, with its 95 % bootstrap interval over runs. *Capped*: the same, but
no run counts as worse than the INS's MRSE, and one that failed counts as that, since it is what
is left without an estimate.

**Bound.** The posterior Cramér–Rao bound of the unfiltered readings, root mean square over the
window: for filters that of filtering, for smoothers that of their data; the INS is set beside the
filtering bound, what aiding could give. It is the bound of the declared model, which the truth of
a case need not follow. *Efficiency* = MRSE / bound.

**Causality.** A *filter* knows at each epoch the readings up to it; a *fixed-lag* smoother those of
some more epochs; a *batch* smoother those of the whole flight. The last two answer later, and are
never ranked beside filters.

**Success.** A run succeeds if it finishes, does not diverge, and ends where it should: where the
scenario says within what distance a position counts as found, locked; elsewhere within {bounds:.0f}
bounds, or {part:.0f} % of the INS's error, whichever is larger, both root mean square at the end of
the flight. To be no worse than the INS is no success: the INS's own share says how often that comes
by itself. Shares have Wilson's 95 % interval. A run *fails* if the estimator raises an exception,
returns what is no estimate, or exceeds its time. It *diverges* if its final position error exceeds
both ten bounds and the pure INS's. It is *locked* from the epoch on from which its error stays
below that distance to the end of the flight, and *falsely locked* if at the end it is not, but
claims to be with 95 %.

**Error over bound.** Of the runs that succeed: the error of each over the bound. Given are the
median with its 95 % interval between order statistics, the quartiles, and the 95th percentile. In
tables of many cases, and in the league, an estimator that got fewer runs has the best one's median,
divided by the mean ratio of the two errors over the runs in which both succeed (marked ~): its own
median is of other runs. An efficient estimator's median lies below 1, at about 0.9: the bound is
that of the root mean square, and errors are skewed.

**Consistency.** *NEES* of the six position and velocity errors, 6 if consistent; its 95 % band
treats each run as a single draw, so that its false-alarm rate is below 5 %. *Coverage*: share of
epochs whose truth lies in the claimed 95 % region, with a band of the same kind. *NIS*:
normalised innovation squared, the number of components if consistent; a consistent filter's
innovations are white, so that the band counts every epoch and is far narrower.

**Honest.** An estimator is honest in a case if its coverage is {coverage:.0f} % or more, and it is
falsely locked in {false:.0f} % of the runs at most, or in a single one. Both as they were found: by
the ends of intervals few runs would let pass what many do not; of few runs the mark is in part
chance. One that is not is marked †, and never advised.

**The best of a case.** Of the causal estimators that succeed as often as the one that succeeds
most (intervals overlap) and that failed in at most {failed:.0f} % of the runs: an honest one if
there is any, one that got all runs if there is any, and of those the one with the least median of
error over bound; of medians equal to three digits the cheaper one.

**Verdicts.** Two estimators are compared on the same runs. One is *better* if it succeeds surely
more often (McNemar's exact test, 5 %); or if neither does, and of the runs in which both succeed
the 95 % bootstrap-t interval of the mean logarithm of the ratio of errors leaves 0 out, and the
sign test says the same (5 %). They are *as good* as each other if neither succeeds surely more
often and that interval lies within {alike:.0f} % of equality, over {fewest} runs or more. Else
the runs are *too few to tell* (*not distinguishable*). Of estimators that do not differ at most
one pair in ten is called better or worse. Verdicts are of statistics, each pair by itself.

**As good as the best.** By the verdict; *or it may be*: the runs are too few to tell, and its error
is at most {uncertain:.0f} % larger, run by run. It must not fail in more than {failed:.0f} % of the
runs.

**Cost.** Median time of a run in one process, warmed up. *Map points*: positions at which a run
evaluates the field. Compiled estimators take many runs at once; `filterpy-ekf`, `filterpy-ukf` and
`gtsam` are the frameworks, called from Python run by run.

**σ/ℓ.** The standard deviation of the initial position per horizontal axis over the field's
correlation length: the lag along the flown track at which the autocorrelation of the vertical
gradient, less its mean, first falls to 1/e.
"""


TERMS = {
    r"\berrors? (/|over) bound|\bquartiles\b|^95 %$|× the bound": "Error over bound",
    r"\bas good\b|\bgood in\b": "As good as the best",
    r"\bhonest\b|†": "Honest",
    r"\bbest\b": "The best of a case",
    r"\b(succeed|success|lost|failed|diverged|falsely|locked|false locks?)": "Success",
    r"\b(verdict|sign test|alone|ratio of errors|against|better|worse|too few runs)\b": "Verdicts",
    r"\bgain\b": "Verdicts",
    r"\b(NEES|NIS|coverage|band)\b": "Consistency",
    r"\b(bound|efficiency)\b": "Bound",
    r"\b(MRSE|capped|error)\b": "Error",
    r"\bcausality\b|\bsmoothers\b": "Causality",
    r"\bms\b|\btime /|\bmap points\b|\bcost\b": "Cost",
    r"σ/ℓ": "σ/ℓ",
}
"""Words of column heads, as regular expressions, to the definition that has them: the first."""


def title_of(words: str) -> str | None:
    """Return the title of the definition that says what a column's head means, if one does."""
    return next((title for key, title in TERMS.items() if re.search(key, words, re.I)), None)


def text() -> str:
    """Return the page: a paragraph for each definition, which begins with its title in bold."""
    return _TEXT.format(
        coverage=100.0 * LEAST_COVERAGE, false=100.0 * MOST_FALSE, failed=100.0 * MOST_FAILED,
        bounds=BOUNDS, part=100.0 * INS_FRACTION, alike=100.0 * (EQUIVALENCE_RATIO - 1.0),
        fewest=FEWEST, uncertain=100.0 * (UNCERTAIN - 1.0),
    )  # fmt: skip


def write(output: Path) -> None:
    """Write the page into a folder of reports."""
    (output / DEFINITIONS).write_text(text(), encoding="utf-8")
