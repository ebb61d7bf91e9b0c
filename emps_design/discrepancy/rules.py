"""Every number that decides on an answer, in the order of docs/theory/diagnosis.md."""

from __future__ import annotations

# Shares, for all that is a part of something
BARELY = 1e-3  # of a command, of a cost: less is not seen, and leads no further
NEGLIGIBLE = 0.02  # counts as nothing: of a travel, of samples, of a speed, of a cost, of a motion that follows
SLIGHT = 0.05  # of a size, a time, a gain, of the noise: less does not matter
MINOR = 0.1  # of a force or a gain: less may be noise, is no suspect, is looked at last
QUARTER = 0.25  # of a bandwidth, for the loop around it; of a mean speed: less deviation is one speed only
SOME = 0.3  # of the noise in a force, of a gain where it must show again: less is none
PART = 0.2  # of a mean square: a variable that predicts it is named, a force with it elsewhere is no force of reversals
THIRD = 1 / 3  # of the strokes are held out; laps that agree so much better than others tell the noise
HALF = 0.5  # of the best gain, of a number: more competes, or moved too far; of an effect or excess: less is not enough
CLEARLY_LESS = 0.7  # of what first differences of laps, or few shapes of a force, leave: second ones, more shapes pay
MOST = 0.8  # of what changes is improvement, of a gap explained on any record, of a force in its extent
NEARLY_ALL = 0.9  # of a structure, of a power in its band, of a gain, of a time, of a motion: as good as all
TWICE = 2.0  # the noise of a loop, the cost of a fit: more is loud, or another place

# Records that can be judged
SHORTEST = 2.0  # s
FEWEST_STEPS = 20  # of the encoder: a shorter stroke is no motion
AT_LIMIT = 0.999  # of the voltage limit, from which on a sample counts as limited
SLOW = 0.02  # m/s of an ordinary axis, below which Stribeck friction is seen
MOST_SAMPLES = 1_000_000  # of all records together, which take 1.7 GB of memory; of more only the beginning is searched
SEARCHED = 150_000  # samples of such a beginning, from the first motion on
PIECE_TIME = 10.0  # s, of the pieces of a long record whose residuals are compared

# The parts of a record
START_UP = 50  # samples left out at the start of a record: the loop's own transient, as in the published figures
MOST_TURNS = 12  # pieces that stand for the strokes of a shaft turning one way
PARTS = 4  # of each stroke, where there are too few strokes to hold some out
LAPS = 3  # from which on one is held out: two others give the noise, and any two of three that agree
FEWEST = 500  # samples to fit, and to confirm
FEWEST_TO_SELECT = 200  # samples; also to regress a missing force on

# A record that a model follows
BANDWIDTH_HZ = 25.0  # of the velocity loop that follows; the encoder's noise, differentiated, sets the upper end
LEAST_SAMPLES = 40  # per period of that bandwidth: with fewer the two-tap velocity loses too much phase
FAST_SAMPLES = 12  # the same where the command itself is that fast
COMPARED = 1.3  # of the bandwidth, up to which forces are compared: beyond it the law amplifies the encoder's noise

# The missing force
CUTOFF_HZ = 60.0  # where the command is no faster
FASTEST = 0.4  # of the sampling rate, to which a fast command raises the cut-off
SLOWEST_PERIOD = FASTEST / CUTOFF_HZ  # s, longest for its filters
NOISY = 0.03  # of an acceleration: largest encoder noise in the band of the motion

# The controller's law
BLOCK_TIME = 0.02  # s, over which its gap, and the missing force at first sight, are averaged

# The clock of a command, in samples
CLOCK_RANGE = 2  # looked for to either side: a longer shift is a delay of the drive
CLOCK_STEP = 0.1

# Noise
UNUSUAL = 2.5  # times the deviation of a piece, or of a sample at the floor: beyond is an event, or a burst, not noise
LINE = 25.0  # times the usual power, beyond which a line of the spectrum is a tone
NEIGHBOURS = 40  # lines on both sides, whose median is the usual power
ORDER = 24  # of the autoregressive model of the noise
PIECE = 500  # samples that structure of noise or of a residual spans: pieces, clusters, what is resampled together
INTERVAL = (0.025, 0.975)  # quantiles
NORMAL = 1.96  # standard deviations to either side that are such an interval
RIDGES = tuple(10.0**power for power in range(-9, 1))  # of the mean square of a column; the best on held-out strokes
MOST_REGRESSED = 60_000  # samples of whole strokes that tell the noise, evenly thinned where there are more
FINER = 0.95  # of the floor: a model that leaves less than this share shows that the floor was not all noise

# What chance gains
LEVEL = 0.01  # share of healthy records on which the threshold is reached, over all candidates together
RESAMPLES = 199  # of noise: the fewest from which a hundredth can be read

# A fit
LEAST_MASS = 0.01  # of the axis file's: with almost no mass friction dominates, and a simulation takes very long
LOOSE = 1e5  # times the integrator's tolerance: force within 2e-3 N, a hundredth of any noise here, six times faster
CACHE = 128e6  # bytes of residuals that are kept
WORST = 1e12  # cost of a model that cannot be simulated; finite for a fit to step back from it
NOTHING = 1e-6  # of a size: a number so close to its bound ended on it, a combination of functions is none
NUDGE = 2e-4  # finite difference of a fit, in magnitudes of the parameter
STEP = 1e-3  # the same of a sensitivity, over which play counts as smooth
COARSE_NUDGE = 5e-3  # the same of a fit where the fine one finds no descent and structure is left, as with play
DAMPING = 1e-3  # of the diagonal of the normal equations, at first; the least is next to nothing
TRIALS = 6  # of one step, with more and more damping
CONVERGED = (1e-4, 0.1)  # gain of a step, as a share of the cost and absolute, below which a descent ends
SHORT_STEPS = 4  # of a fit that only shows whether a longer one pays; twice that for a rival in a finding's place
NOISES = 3  # draws of noise on the simulated carriage

# A fit with play, which makes the cost rough
SIMPLEX = 60  # simulations of the first descent
SPAN = 0.3  # of the logarithm of each number, the first simplex
SURFACES = 30  # at most, one after the other
CLOSER = 0.6  # of the neighbourhood is the next one where a surface led no further
OFTEN = 4  # corrections of the first simplex; surfaces after which the next neighbourhood is closer in any case
FARTHEST = 4.0  # neighbourhoods that a step may lead away
IN_VAIN = 5  # surfaces one after the other that led no further, though not astray: there is nothing more to find
ALIKE = 4.0  # times the deviation of the costs on a surface, up to which a place is as good as the best

# The search
CORES = 2  # on which fits run side by side
PATIENCE = 0.05  # s, within which a waiting thread handles an interrupt
FEW = 2  # the best that go on to a longer fit: starts of an effect, effects, shapes; effects beside an unknown force
FINALISTS = 4  # effects of a round, or shapes of an accepted effect, that are fitted in full
BENT_STARTS = 6  # of an effect, fitted where the gap bent the baseline
BEAM = (3, 2, 1)  # sets kept after the first round, the second, and any later one
A_FEW = len(BEAM)  # records that propose; effects after which a kind of force is looked for, a poor search given up
MOST_EFFECTS = 7
IN_TURN = 3  # times that two things are estimated in turn: noise and model, a force in the loop and numbers beside it
BENT = 20.0  # whitened cost per sample beyond which missing physics may have bent the fitted baseline
SMALLEST_GAIN = 30.0  # in whitened cost; below the chance level of a search over hundreds of shapes
MAY_RIVAL = 0.6  # of either share: gain of the first step of a short fit from which the fit continues
LEAST_EXPLAINED = 0.4  # of the excess over noise, below which a search ends after a few effects
IN_REACH = 1.5  # times the cost of a fit: another shape, or place, that leaves more is out of reach
CREDIBLE = 5  # effects up to which slower methods are used, and detours taken: more imitate something unknown
STILL_PAYS = 0.005  # of the cost: a fit that gains less has converged
WORTH_DESCRIBING = 0.002  # of the cost: gain that a further effect of the closest model must reach

# What is accepted
WORTH = 0.01  # of the whitened cost that a finding must gain: half a percent of the residual force
WORTH_AT_FLOOR = 0.03  # the same where only noise is left to explain
CHANCE = 2.0  # standard deviations that chance may take: of a stroke's cost, of a force, of a difference in cost
SURE = 3.0  # standard deviations of a difference that is none by chance
BURST = 5.0  # standard deviations at which a sample's cost is capped
STRUCTURED = 1.5  # whitened cost per sample beyond which a model leaves structure
AT_FLOOR = 1.2  # whitened cost per sample up to which a model leaves nothing but noise

# What the confirming record says
HUBER = 1.345  # standard deviations beyond which the influence is constant: 95 % efficient for Gaussian noise
ROBUST_STEPS = 20  # of each of these fits: it may end far from least squares
HALVINGS = 7  # by which the end of a range of equal instants is found: a hundredth of the last step

# The verdict
QUIET = 1.5  # times the noise, in force: residual of a whole record up to which nothing may be missing
MOST_EQUIVALENTS = 3  # with more a finding has no name
EQUIVALENT = 0.03  # of a gain where structure is left: a rival this close is an equivalent, a rest this small is none
PLAIN = 4.0  # times the whitened cost of noise: excess from which an unknown force of one kind may end the search
OFF = 0.005  # of a parameter's magnitude: relevant error of the axis file

# An unknown force
REVERSAL_MARGIN = 0.06  # s on both sides of a reversal, where a zero-phase filter mixes the two directions
SLOWEST = 2e-3  # m/s of an ordinary axis, below which the direction of motion is not certain
DEGREE = 4  # of polynomials in position and in speed; twice that of those in one variable alone
FADING_TIMES = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)  # s, of a memory: one that lasts a stroke would be a spring
RESTING_TIME = 0.04  # s, in which a contact ages at rest
FADING_WAYS = (1e-4, 5e-4, 2e-3, 1e-2)  # m since a reversal, of an ordinary stroke
DEGREE_ALONG = 6  # of a kind's polynomials in position; twice that where the finer shape leaves clearly less
LOOP_SHARES = (1.0, 0.5, 0.25, 0.125)  # of a force that is put in the loop

# Where, how much, and in words
FALSE_REGIONS = 0.05  # share of false regions among those in which a force is placed, on average
CELLS = 160  # of a coordinate: resolution of an extent
CELL_TIME = 0.05  # s, the same over time; two of them on both sides are the neighbourhood of a reversal
APART = 0.3  # s between two separate intervals of time
MOST_INTERVALS = 6  # more are no events
PEAK = 0.995  # quantile of the force for "up to"
DRAWS = 19  # of the parameters: with the fitted ones, their range is a 90 % interval
FAR = 300.0  # factor on a shape at which an effect has faded, times a typical size at which it was never excited
CLOSE = 1.1  # ratio of sizes that are alike: of a limit of detection, of velocity errors in a free run
FEW_STEPS = 3  # of a fit that begins near its end: without one effect, or of a rival on an excitation
LINES_HZ = (2.0, 100.0)  # of a spectrum: lower lines belong to the strokes, higher ones to no drive here

# The experiment
LASTING = (10.0, 25.0)  # s: the cycles of an excitation repeat until the first, and none starts after the second
