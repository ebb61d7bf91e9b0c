"""Every threshold that decides on an answer, in the order of docs/theory/diagnosis.md."""

from __future__ import annotations

# Records that can be judged
SHORTEST = 2.0  # s
STILL = 1e-4  # m, a reference that moves less is no motion
AT_LIMIT = 0.999  # of the voltage limit, from which on a sample counts as limited
SATURATED = 0.5  # share of samples at the voltage limit beyond which nothing can be judged
BACKWARD = 0.05  # of the moving time against the main direction, from which on Coulomb and constant force differ
ONE_SPEED = 0.25  # of the mean speed: with less deviation neither mass nor friction can be identified
FEWEST_TO_FIT = 500  # samples
FEWEST_TO_SELECT = 200  # samples
FEWEST_TO_CONFIRM = 500  # samples

# The controller's law
LAW_HOLDS = 0.05  # a law holds where it misses the voltage by less than this share of it, in the median
LAW_STRUCTURE = 4.0  # a gap has structure when its block means vary this many times more than white noise would
LAW_VISIBLE = 1e-3  # of the deviation of the voltage, below which block means count as no structure
LAW_NAMED = 0.9  # share of the structure an effect must explain

# Noise
DRIFTS = 0.7  # of the rms of first differences between laps, below which second differences are the floor
PUSHED = 1 / 3  # of the difference between laps: where two always agree that much better, the others were disturbed
UNUSUAL = 2.5  # times the typical deviation of a piece, beyond which the piece is an event, not noise
LINE = 25.0  # times the usual power, beyond which a line of the spectrum is a tone
FINER = 0.95  # of the floor: a model that leaves less than this share shows that the floor was not all noise

# What chance gains
LEVEL = 0.01  # share of healthy records on which the threshold is reached, over all candidates together

# The search
LEAST_AMPLITUDE = 0.05  # of a parameter's typical size, below which an effect is negligible
BENT = 20.0  # whitened cost per sample beyond which missing physics may have bent the fitted baseline
BENT_NUMBER = 0.5  # of the larger one: a mass or friction fitted this far from the axis file's may have been bent too
SMALLEST_GAIN = 30.0  # in whitened cost; below the chance level of a search over hundreds of shapes
LOUD = 2.0  # gain of noise in a model, from which on the amplified samples are weighted down in a search
WORTH_FITTING = 0.05  # of the largest first-order gain
RIVAL = 0.5  # share of the best gain from which a set joins the beam, and an effect is fitted in full
FAR_BEHIND = 0.1  # the same where no rival is accepted: the best ones may only imitate the missing effect
MAY_RIVAL = 0.6  # of either share: gain of the first step of a short fit from which the fit continues
CLOSE_RIVAL = 0.9  # of the gain of an effect, from which on a rival in its place is fitted to convergence
LEAST_EXPLAINED = 0.4  # of the excess over noise, below which a search ends after ENOUGH_ROUNDS
ENOUGH_ROUNDS = 3
IN_REACH = 1.5  # times the cost of a fit: another shape that leaves more after its first steps is given up
CREDIBLE = 5  # effects up to which the search uses its slower methods; more effects imitate something unknown
STILL_PAYS = 0.005  # of the cost: a fit that gains less has converged
WORTH_DESCRIBING = 0.002  # of the cost: gain that a further effect of the closest model must reach
ON_BOUND = 1e-6  # of a number's magnitude: a parameter this close to its bound ended on it

# What is accepted
WORTH = 0.01  # of the whitened cost that a finding must gain: half a percent of the residual force
WORTH_AT_FLOOR = 0.03  # the same where only noise is left to explain
AUDIBLE = 0.3  # of the floor: amplitudes of force below it are not findings
SEEN_AGAIN = 0.3  # of the gain per sample on the fitting part must be there on the selecting part
STROKES = 0.8  # of what the selecting strokes change must be improvement
CHANCE = 2.0  # standard deviations of a stroke's cost
BURST = 5.0  # standard deviations at which a sample's cost is capped
BURST_AT_FLOOR = 2.5  # the same where only noise is left to explain: an effect then shows a little in all samples
STRUCTURED = 1.5  # whitened cost per sample beyond which a model leaves structure
AT_FLOOR = 1.2  # whitened cost per sample up to which a model leaves nothing but noise

# What the confirming record says
ASKED_APART = 0.3  # deviation of a share from 1, beyond which a record refutes the effect
HALF = 0.5  # mean share of all weightings, below which an effect is withdrawn
SHARE_KNOWN = 0.1  # deviation of a share, beyond which an effect beside something unknown does not stand
SURE = 3.0  # standard deviations
EXERCISED = 0.05  # standard deviations of the noise: rms change by an effect, below which a record does not exercise it
BETTER_PROPOSAL = 0.98  # of the cost with the old per-record parameters, which a proposal for them must stay below
BETTER_FIT = 0.995  # the same for the fit that follows

# The verdict
FREE_RUN = 1.1  # times the baseline's velocity error, driven by the command alone, beyond which a model is refuted
EXPLAINED = 0.8  # of the excess over the floor, in force, a model must explain to stand where it does not reach it
QUIET = 1.5  # times the noise, in force: residual of a whole record up to which nothing may be missing
COMPLETE = 0.97  # of the excess: a model that explains more leaves nothing to name, even with structure
HELD = 0.8  # of the share explained on the training record must be explained on the confirming one
LOST = 0.05  # of the gain of a model; where refuted effects contributed more, the rest is doubtful too
MOST_EQUIVALENTS = 3
EQUIVALENT = 0.03  # of the gain of a finding: a rival this close is an equivalent where structure is left
OF_A_KIND = 0.5  # of the excess of the baseline, which a kind of unknown force must explain
PLAIN = 4.0  # times the whitened cost of noise: excess from which an unknown force of one kind may end the search
FEW_BESIDE = 2  # effects beside it, at most, with which it ends the search
SHARPER = 0.7  # of the excess left by a kind of unknown force, which finer shapes must stay below
DEPENDS = 0.2  # of the mean square of the residual, from which a variable that predicts it is named
OFF = 0.005  # of a parameter's magnitude: relevant error of the axis file
OFF_SURELY = 3.0  # standard deviations: significant error of the axis file

# The experiment
LUCK = 2.0  # standard deviations of a difference in cost that chance may take from the right model
SLACK = 0.05  # by which a motion may exceed the extremes of the same model on the records
