"""Every constant that decides on an answer, in the order of docs/theory/diagnosis.md."""

from __future__ import annotations

# Shares, wherever a part is compared with a whole
BARELY = 1e-3  # of a command or a cost: a smaller change is not visible and ends an iteration
NEGLIGIBLE = 0.02  # of a travel, of samples, of a speed, of a cost, of the recorded motion: a smaller part is ignored
SLIGHT = 0.05  # of a size, a time, a gain, of the noise: a smaller part does not matter
MINOR = 0.1  # of a force or a gain: a smaller part may be noise, is no suspect, and is tested last
QUARTER = 0.25  # of a bandwidth: for the loop around it; of a mean speed: with less deviation there is only one speed
SOME = 0.3  # of the noise in a force, of a gain that must be confirmed: a smaller part does not count
PART = 0.2  # of a mean square: a variable that predicts more is named; a force at reversals has less elsewhere
THIRD = 1 / 3  # of the strokes is held out; of a lap difference: two laps that agree better give the noise
HALF = 0.5  # of the best gain or a parameter: more is a rival or a bias; of an effect or the excess: less is too little
CLEARLY_LESS = 0.7  # of what first differences of laps, or a simpler force, leave: then second ones, or a finer one
MOST = 0.8  # of a change that must be improvement, of a gap explained on every record, of a force within its extent
NEARLY_ALL = 0.9  # of a structure, of the power in a band, of a gain, of a time, of a motion: counts as all
TWICE = 2.0  # the noise of a loop: above it noise is amplified; the cost of a fit: the edge of a neighbourhood

# Records that can be judged
SHORTEST = 2.0  # s
FEWEST_STEPS = 20  # of the encoder: a shorter stroke does not count as motion
AT_LIMIT = 0.999  # of the voltage limit, from which a sample counts as limited
SLOW = 0.02  # m/s of an ordinary axis, below which Stribeck friction is seen
MOST_SAMPLES = 1_000_000  # of all records together, for 1.7 GB of memory; of longer ones the beginning is searched
SEARCHED = 150_000  # samples of such a beginning, from the first motion on
PIECE_TIME = 10.0  # s, of the pieces of a long record whose residuals are compared

# The parts of a record
START_UP = 50  # samples at the start of a record without weight: the transient of the loop, as in the published figures
MOST_TURNS = 12  # pieces that replace the strokes of a shaft turning one way
PARTS = 4  # of each stroke, where there are too few strokes to hold some out
LAPS = 3  # from which one is held out: the other two give the noise
FEWEST = 500  # samples to fit, and to confirm
FEWEST_TO_SELECT = 200  # samples; also to regress a missing force on

# A record that a model follows
BANDWIDTH_HZ = 25.0  # of the velocity loop of a model that follows; limited by the differentiated encoder noise
LEAST_SAMPLES = 40  # per period of that bandwidth: with fewer the two-tap velocity loses too much phase
FAST_SAMPLES = 12  # the same if the command itself is that fast
COMPARED = 1.3  # of the bandwidth, up to which forces are compared: above it the law amplifies the encoder noise

# The missing force
CUTOFF_HZ = 60.0  # unless the command is faster
FASTEST = 0.4  # of the sampling rate: upper limit of the cut-off for a fast command
SLOWEST_PERIOD = FASTEST / CUTOFF_HZ  # s, longest for its filters
NOISY = 0.03  # of an acceleration: largest encoder noise in the band of the motion

# The controller's law
BLOCK_TIME = 0.02  # s, over which the gap of the law, and the missing force in the quick check, are averaged

# The clock of a command, in samples
CLOCK_RANGE = 2  # searched on both sides: a longer shift is a delay of the drive
CLOCK_STEP = 0.1

# Noise
UNUSUAL = 2.5  # times the deviation of a piece, or of a sample at the floor: above it an event or a burst, not noise
LINE = 25.0  # times the usual power: above it a line of the spectrum is a tone
NEIGHBOURS = 40  # lines on both sides, whose median is the usual power
ORDER = 24  # of the autoregressive model of the noise
PIECE = 500  # samples, correlation length of noise and residuals: pieces, clusters and blocks of the resampling
INTERVAL = (0.025, 0.975)  # quantiles
NORMAL = 1.96  # standard deviations on both sides of that interval
RIDGES = tuple(10.0**power for power in range(-9, 1))  # of the mean square of a column; the best on held-out strokes
MOST_REGRESSED = 60_000  # samples of whole strokes from which the noise is estimated, evenly thinned if there are more
FINER = 0.95  # of the floor: a model with a smaller residual shows that the floor was not only noise

# The threshold of chance
LEVEL = 0.01  # share of healthy records on which the threshold is reached, over all candidates together
RESAMPLES = 199  # of noise: the smallest number that gives a level of one percent

# A fit
LEAST_MASS = 0.01  # of the axis file's: with almost no mass friction dominates, and a simulation takes very long
LOOSE = 1e5  # times the integrator's tolerance: force within 2e-3 N, a hundredth of any noise here, six times faster
CACHE = 128e6  # bytes of cached residuals
WORST = 1e12  # cost of a model that cannot be simulated; finite for a fit to step back from it
NOTHING = 1e-6  # of a size: a parameter so close to its bound is on it; a smaller combination of functions is ignored
NUDGE = 2e-4  # finite difference of a fit, in magnitudes of the parameter
STEP = 1e-3  # the same of a sensitivity, over which play counts as smooth
COARSE_NUDGE = 5e-3  # the same of a fit where the fine one finds no descent and structure remains, as with backlash
DAMPING = 1e-3  # of the diagonal of the normal equations, initially
TRIALS = 6  # of one step, with more and more damping
CONVERGED = (1e-4, 0.1)  # gain of a step, as a share of the cost and absolute, below which a descent ends
SHORT_STEPS = 4  # of a fit that only shows whether a longer one pays; twice that for a rival in a finding's place
NOISES = 3  # draws of noise on the simulated carriage

# A fit with backlash, which makes the cost rough
SIMPLEX = 60  # simulations of the first descent
SPAN = 0.3  # of the logarithm of each parameter: size of the first simplex
SURFACES = 30  # maximum number of response surfaces of a fit
CLOSER = 0.6  # ratio of the next neighbourhood to one whose surface gave no progress
OFTEN = 4  # corrections of the first simplex; surfaces after which the neighbourhood shrinks in any case
FARTHEST = 4.0  # neighbourhoods: longest step
IN_VAIN = 5  # surfaces in a row without progress or deterioration, after which a fit ends
ALIKE = 4.0  # times the deviation of the costs on a surface: a point within that of the best is as good

# The search
CORES = 2  # that run fits in parallel
PATIENCE = 0.05  # s, within which a waiting thread handles an interrupt
FEW = 2  # best starts of an effect, effects or shapes that get a longer fit; effects beside an unknown force
FINALISTS = 4  # effects of a round, or shapes of an accepted effect, that are fitted in full
BENT_STARTS = 6  # of an effect, fitted where the gap biased the baseline
BEAM = (3, 2, 1)  # sets kept after the first round, the second, and any later one
A_FEW = len(BEAM)  # records that propose; effects after which a kind of force is tried or a poor search is abandoned
MOST_EFFECTS = 7
IN_TURN = 3  # iterations between two estimates: noise and model, a force in the loop and the other parameters
BENT = 20.0  # whitened cost per sample above which missing physics may have biased the fitted baseline
SMALLEST_GAIN = 30.0  # in whitened cost; below the chance level of a search over hundreds of shapes
MAY_RIVAL = 0.6  # of either share: gain of the first step of a short fit from which the fit continues
LEAST_EXPLAINED = 0.4  # of the excess over noise, below which a search ends after a few effects
IN_REACH = 1.5  # times the cost of a fit: a shape or point with a higher cost is not pursued
CREDIBLE = 5  # effects up to which slower methods and detours are used: more are likely to imitate an unknown force
STILL_PAYS = 0.005  # of the cost: a fit that gains less has converged
WORTH_DESCRIBING = 0.002  # of the cost: gain that a further effect of the closest model must reach

# Acceptance
WORTH = 0.01  # of the whitened cost that a finding must gain: half a percent of the residual force
WORTH_AT_FLOOR = 0.03  # the same where only noise is left to explain
CHANCE = 2.0  # standard deviations allowed for chance: of a stroke's cost, of a force, of a difference in cost
SURE = 3.0  # standard deviations of a significant difference
BURST = 5.0  # standard deviations at which a sample's cost is capped
STRUCTURED = 1.5  # whitened cost per sample above which the residual has structure
AT_FLOOR = 1.2  # whitened cost per sample up to which the residual is only noise

# Confirmation
HUBER = 1.345  # standard deviations beyond which the influence is constant: 95 % efficient for Gaussian noise
ROBUST_STEPS = 20  # of each of these fits: it may end far from least squares
HALVINGS = 7  # that locate the end of a range of equal instants, to a hundredth of the last step

# The verdict
QUIET = 1.5  # times the noise, in force: residual of a whole record up to which no effect is missing
MOST_EQUIVALENTS = 3  # a finding with more of them is not named
EQUIVALENT = 0.03  # of a gain where structure remains: a rival within it is an equivalent, a smaller rest is ignored
PLAIN = 4.0  # times the whitened cost of noise: excess from which an unknown force of one kind may end the search
OFF = 0.005  # of a parameter's magnitude: relevant error of the axis file

# An unknown force
REVERSAL_MARGIN = 0.06  # s on both sides of a reversal, where a zero-phase filter mixes the two directions
SLOWEST = 2e-3  # m/s of an ordinary axis, below which the direction of motion is not certain
DEGREE = 4  # of polynomials in position and in speed; twice that of those in one variable alone
FADING_TIMES = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)  # s, of a memory: one as long as a stroke would be a spring
RESTING_TIME = 0.04  # s, time constant of the ageing of a contact at rest
FADING_WAYS = (1e-4, 5e-4, 2e-3, 1e-2)  # m since a reversal, of an ordinary stroke
DEGREE_ALONG = 6  # of a kind's polynomials in position; twice that where the finer shape leaves clearly less
LOOP_SHARES = (1.0, 0.5, 0.25, 0.125)  # of a force that is applied in the loop

# Extent, size and description
FALSE_REGIONS = 0.05  # share of false regions among those in which a force is placed, on average
CELLS = 160  # of a coordinate: resolution of an extent
CELL_TIME = 0.05  # s, the same over time; two of them on both sides are the neighbourhood of a reversal
APART = 0.3  # s between two separate intervals of time
MOST_INTERVALS = 6  # more intervals are not events
PEAK = 0.995  # quantile of the force for "up to"
DRAWS = 19  # of the parameters: with the fitted ones, their range is a 90 % interval
FAR = 300.0  # factor on a shape at which an effect has vanished, times a typical size at which it was never excited
CLOSE = 1.1  # ratio of equal sizes: of a limit of detection, of velocity errors in a free run
FEW_STEPS = 3  # of a fit that starts near its end: without one effect, or of a rival on an excitation
LINES_HZ = (2.0, 100.0)  # of a spectrum: lower lines belong to the strokes, higher ones to no drive considered here

# The experiment
LASTING = (10.0, 25.0)  # s: the cycles of an excitation repeat until the first, and none starts after the second
