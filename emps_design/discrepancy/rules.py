"""Every threshold that decides on an answer, in the order of docs/theory/diagnosis.md."""

from __future__ import annotations

# Records that can be judged
SHORTEST = 2.0  # s
STILL = 1e-4  # m, a reference that moves less is no motion
AT_LIMIT = 0.999  # of the voltage limit, from which on a sample counts as limited
SATURATED = 0.5  # share of samples at the voltage limit beyond which nothing can be judged
ONE_SPEED = 0.25  # of the mean speed: less deviation from it tells neither mass nor friction
FEWEST_TO_FIT = 500  # samples
FEWEST_TO_SELECT = 200  # samples
FEWEST_TO_CONFIRM = 500  # samples

# The controller's law
LAW_HOLDS = 0.05  # a law holds where it misses the voltage by less than this share of it, in the median
LAW_STRUCTURE = 4.0  # a gap has structure when its block means vary this many times more than white noise would
LAW_VISIBLE = 1e-3  # of the voltage's deviation, below which the block means are no structure
LAW_NAMED = 0.9  # share of the structure an effect must explain

# Noise
DRIFTS = 0.7  # of the rms of first differences between laps, below which second differences are the floor
PUSHED = 1 / 3  # of what laps differ by: where two always agree that much better, something pushed the others
UNUSUAL = 2.5  # times the typical deviation of a piece, beyond which a piece is an event and no noise
LINE = 25.0  # times the usual power, beyond which a line of the spectrum is a tone
FINER = 0.95  # of the floor: a model that brings it below this share shows that it was no noise

# What chance gains
LEVEL = 0.01  # share of healthy records on which the threshold is reached, over all candidates together

# The search
LEAST_AMPLITUDE = 0.05  # of a parameter's typical size, below which an effect is none
BENT = 20.0  # whitened cost per sample beyond which a fitted baseline may have been bent by what is missing
BENT_NUMBER = 0.5  # of the larger one: a mass or friction fitted this far from the axis file's may have been bent too
SMALLEST_GAIN = 30.0  # in whitened cost; below the chance level of a search over hundreds of shapes
LOUD = 2.0  # times its own size: noise that grows to this somewhere is weighed while effects are looked for
WORTH_FITTING = 0.05  # of the largest first-order gain
RIVAL = 0.5  # a set joins the beam, an effect the full fits, with this share of what the best one explains
FAR_BEHIND = 0.1  # the same where no rival is accepted: the best ones may stand in for what is found later
MAY_RIVAL = 0.6  # of either share, from which an effect may still come to it after the first step of a short fit
CLOSE_RIVAL = 0.9  # of what an effect explains, from which on another one in its place is fitted as long as it was
LEAST_EXPLAINED = 0.4  # of the excess over noise, below which a search is given up after ENOUGH_ROUNDS
ENOUGH_ROUNDS = 3
IN_REACH = 1.5  # times the cost of a fit: another shape that leaves more after its first steps does not become the best
CREDIBLE = 5  # effects of a model up to which the search takes more pains; more stand in for something unknown
STILL_PAYS = 0.005  # of the cost: a fit that gains less has converged
WORTH_DESCRIBING = 0.002  # of the cost: what the model that follows most closely must gain by an effect more
ON_BOUND = 1e-6  # of a number's magnitude: a parameter this close to its bound ended on it

# What is accepted
WORTH = 0.01  # of the whitened cost: what lowers the residual force by less than half a percent is no finding
WORTH_AT_FLOOR = 0.03  # the same where only noise is left to explain
AUDIBLE = 0.3  # of the floor: amplitudes of force below it are not findings
SEEN_AGAIN = 0.3  # of the gain per sample on the fitting part must be there on the selecting part
STROKES = 0.8  # of what the selecting strokes change must be improvement
CHANCE = 2.0  # standard deviations of a stroke's cost
BURST = 5.0  # standard deviations beyond which a sample counts no more
BURST_AT_FLOOR = 2.5  # the same where only noise is left to explain: an effect then shows in all samples a little
STRUCTURED = 1.5  # whitened cost per sample beyond which a model leaves structure
AT_FLOOR = 1.2  # whitened cost per sample up to which a model leaves nothing but noise

# What the confirming record says
ASKED_APART = 0.3  # from all of an effect, beyond which a record refutes it
HALF = 0.5  # of all of an effect: if all weighings of what the model leaves ask for less on average, it is none
SHARE_KNOWN = 0.1  # deviation of the share asked for, beyond which an effect beside something unknown does not stand
SURE = 3.0  # standard deviations
EXERCISED = 0.05  # standard deviations of the noise that an effect must change in the mean to be seen at all
BETTER_PROPOSAL = 0.98  # of the cost: a proposal for what belongs to a record must leave less than with the old numbers
BETTER_FIT = 0.995  # the same for the fit that follows

# The verdict
FREE_RUN = 1.1  # times the baseline's velocity error, driven by the command alone, beyond which a model is refuted
EXPLAINED = 0.8  # of the excess over the floor, in force, a model must explain to stand where it does not reach it
QUIET = 1.5  # times the noise, in force: of all of a record, held out or not, up to which nothing may be missing
COMPLETE = 0.97  # of the excess: a model that explains more leaves nothing to name, whatever its structure
HELD = 0.8  # of the share explained on the training record must be explained on the confirming one
LOST = 0.05  # of what the model explained; if refuted effects carried more, the rest is doubtful too
MOST_EQUIVALENTS = 3
EQUIVALENT = 0.03  # of what a finding gains: a rival this close is an equivalent where structure is left
OF_A_KIND = 0.5  # of what the baseline leaves beyond noise: a kind of unknown force that explains less is not it
PLAIN = 4.0  # times the whitened cost of noise that an unknown force of one kind must explain to be all there is
FEW_BESIDE = 2  # effects beside it with which it may be
SHARPER = 0.7  # of what a kind of unknown force leaves beyond noise: finer shapes must leave less to be taken
DEPENDS = 0.2  # of what is left, from which on a variable that predicts so much of it is named
OFF = 0.005  # of a number's magnitude: an axis file that is further off, for sure, is wrong
OFF_SURELY = 3.0  # standard deviations

# The experiment
LUCK = 2.0  # standard deviations of a difference in cost that chance may take from the right model
SLACK = 0.05  # by which a motion may exceed what the same model does on the records
