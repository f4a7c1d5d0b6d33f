"""Sentences of documents, with a name in each place that differs. The judge and the service make them; a catalogue translates them.

A sentence that is not here stays English on a page in another language. Advice of alert conditions needs no entry: the catalogue takes it
from `CONDITIONS`.
"""

N_ = str  # marks a text for the catalogue
VERDICTS = (
    N_("all joints are as they were at the beginning"),
    N_("nothing is known yet"),
    N_("not known yet"),
    N_("friction {change} ± {std} since the beginning"),
    N_("a step of the last {days} days up to {rise} may be unseen"),
    N_("nothing is learnt of wear: {why}"),
    N_("the last replay does not resolve this joint's friction"),
    N_("the last replay is {change} off: waiting for the next"),
    N_("{temperature} °C is outside the temperatures learnt so far"),
    N_("wear_rising ({tier}): {change}"),
    N_("sudden_step ({tier}): {change}"),
    N_("friction_falling ({tier}): {change}"),
    N_("temperature_sensor ({tier})"),
    N_("data_quality ({tier})"),
    N_("outside_range ({tier})"),
    N_("common_mode: {text}"),
    N_("gain_contradiction: {text}"),
    N_("mounting_contradiction: {text}"),
    N_("payload_contradiction: {text}"),
    N_("store_restored: {text}"),
    N_("nothing_learnt: {text}"),
    N_("stopped: {text}"),
    N_("stale: {text}"),
    N_("unheard: {text}"),
    N_("Base (joint 1): {text}"),
    N_("Shoulder (joint 2): {text}"),
    N_("Elbow (joint 3): {text}"),
    N_("Wrist 1 (joint 4): {text}"),
    N_("Wrist 2 (joint 5): {text}"),
    N_("Wrist 3 (joint 6): {text}"),
    N_("STALE: {who}: nothing was learnt {since}: the state is of then, not of {then}"),
    N_("all joints"),
    N_("now"),
    N_("the period's end"),
    N_("for {days} days (health.stale_days = {limit})"),
    N_("since {when}"),
    N_("in this period"),
    N_("yet (health.stale_days = {limit})"),
)
ALERTS = (
    N_(
        "friction at {speed} rad/s and {temperature} °C went from {before} to {after} N·m ({change} ± {std}), temperature taken out "
        "({slope}/K); {replays} replays on {days} days in a row agree."
    ),
    N_(
        "friction at {speed} rad/s and {temperature} °C went from {before} to {after} N·m ({change} ± {std} above the lowest level held, "
        "{fall} from the beginning, reached by {date}), temperature taken out ({slope}/K); {replays} replays on {days} days in a row agree."
    ),
    N_("Of the measured {whole}, temperature makes {temperature}, payload and context {payload}, wear {wear}, chance {chance}."),
    N_("torque that the fit does not explain is {ratio} times that of before, {change} of friction: wear at one place."),
    N_(
        "torque that the fit does not explain is {ratio} times that of before, {change} of friction: wear at one place, now largest "
        "between {low} and {high} rad."
    ),
    N_("friction at {speed} rad/s rose by {change} against friction at {reference} rad/s."),
    N_("Friction has risen in most joints together, by about {change} in {replays} replays: not the wear of one joint."),
    N_("Friction has fallen in most joints together, by about {change} in {replays} replays: not the grease of one joint."),
    N_(
        "Friction has risen in shoulder and elbow most, as an undeclared payload makes it, by about {change} in {replays} replays: "
        "not the wear of one joint."
    ),
    N_(
        "Friction has fallen in shoulder and elbow most, as an undeclared payload makes it, by about {change} in {replays} replays: "
        "not the grease of one joint."
    ),
    N_("{joint} tells no temperature, or none that can be believed, in {replays} replays in a row."),
    N_("{joint} is not resolved, or scatters more than the filter believes, in {replays} replays in a row."),
    N_("{joint} at {temperature} °C is outside the temperatures learnt so far, in {replays} replays in a row."),
    N_("No joint's temperature is known in {replays} replays in a row: of wear nothing is told until one is."),
    N_("the arm carries about {mass} kg {more} than in the replays before, and nobody declared it"),
    N_("Nothing moves since {when}: {why}."),
    N_("It waits for a person."),
    N_("Nothing moves since {when}: every window since then was refused; the last one: {why}."),
    N_("Nothing was learnt of this arm since {when}: what is known of its joints is of then, not of now."),
    N_("The last window: {why}."),
    N_("The arm is not heard since {when}: {why}."),
    N_("The arm is not heard since {when}."),
    N_("more"),
    N_("less"),
    N_("has risen by more than the tier's rise"),
    N_("has fallen by more than the wear tier's rise"),
)
WARNINGS = (
    N_("{joint}: {change} from the expected friction, {sigmas} σ: not learnt from"),
    N_("{joint}: {replays} replays are best explained by a change of the joint: friction is now {change} from the beginning"),
    N_("joints {joints}: the last replays are best explained by a change of most joints together: it is no wear"),
    N_("joints {joints}: the temperature sensor stands still while the other joints warm and cool: not believed"),
    N_("joints {joints}: no temperature: the replay is learnt with more doubt and counts for no alert"),
    N_("joints {joints}: warming or cooling faster than {limit} K/min: the grease lags behind the sensor"),
    N_("joints {joints}: friction at {speed} rad/s is not resolved in this replay"),
    N_("joints {joints}: replays scatter more than the filter believes"),
    N_("{changes}: a new baseline begins, wear is carried over; wear that came with the change cannot be seen"),
    N_("{changes}: its baseline is known from before"),
)
WORK = (
    N_("{joint} was replaced on {day} ({who})."),
    N_("{joint} was overhauled on {day} ({who})."),
    N_("{joint} was greased on {day} ({who})."),
    N_("{joint} was worked on on {day} ({who})."),
    N_("{joint} may have been replaced on {day} ({who})."),
    N_("serviced: {joint} was replaced on {day} ({who})"),
    N_("serviced: {joint} was overhauled on {day} ({who})"),
    N_("serviced: {joint} was greased on {day} ({who})"),
    N_("serviced: {joint} was worked on on {day} ({who})"),
    N_("serviced: {joint} may have been replaced on {day} ({who})"),
    N_("friction {change} ± {std} since it was replaced on {day}"),
    N_("friction {change} ± {std} since it was overhauled on {day}"),
    N_("friction {change} ± {std} since it was greased on {day}"),
    N_("friction {change} ± {std} since it was worked on on {day}"),
    N_("friction {change} ± {std} since it may have been replaced on {day}"),
    N_("The next replays show what it did to friction: {replays} so far."),
    N_("It is a new joint: everything is learnt anew, and what was found before is of the old one."),
    N_("Friction moved by {change} ± {std} with it."),
    N_("Friction counts from this level now."),
    N_("That is no change: it counts from the same level as before."),
    N_("The joint is as worn as before, or nearly: the work has not brought its friction back."),
    N_("Before it: {text}"),
    N_("Wait for the next replays, or ask for one: they show whether the work helped."),
    N_("Look at this joint again: friction is where it was before the work."),
    N_("It is a new joint: friction, noise and wear are learnt anew from the next replay on."),
    N_("The temperature law of the old joint is a first guess."),
    N_("Remaining life is unknown until the new joint shows a trend."),
    N_("Friction may have moved either way: the next replays show by how much, and become its new reference where it moved."),
    N_("The temperature law and the noise of its replays stay."),
    N_("Remaining life is counted from the new reference; until then it says what it said before."),
    N_("{alert} ({tier}, at its gravest {change}): waits for its proof by the next replays."),
    N_("{alert} ({tier}, at its gravest {change}): cleared, {why}."),
    N_("No alert of this joint was active."),
    N_("{replays} replays between the work and this declaration are not used for the new reference."),
    N_("What was found before stays in the history."),
    N_("its condition is gone, and it was acknowledged"),
    N_("unacknowledged"),
    N_("unshelved"),
    N_("serviced"),
)
LIFE = (
    N_("if friction goes on along a straight line"),
    N_("if friction slows down as it has so far (probability {percent} %)"),
    N_("if friction goes on along a straight line as it has so far (probability {percent} %)"),
    N_("if friction goes on accelerating as it has so far (probability {percent} %)"),
    N_("a path that accelerates (probability {percent} %) reaches the limit in {days} d"),
    N_("{joint}: the limit in {days} d {assumption}."),
    N_("The ± of wear does not hold for a fresh step: one of the last {days} days may be unseen up to {each}."),
)
WINDOWS = (
    N_("missed: the arm's temperatures were not steady while the window was open"),
    N_("missed: the monitor or its host was not running, or had another replay under way"),
    N_("no permission: {why}"),
    N_("no permission"),
    N_("missed"),
    N_("motion_allowed: {why}"),
    N_("approach_near: {why}"),
    N_("approach_near"),
    N_("{joint} is {far} rad from the start of the excitation; at most {limit}"),
    N_("speed_scaling: {why}"),
    N_("the pendant's slider is at {percent} %; expected 100 %"),
    N_("the arm is moving: {joint} at {speed} rad/s; expected standstill"),
    N_("protective_stop"),
    N_("{joint} needs {torque} N·m where {expected} ± {allowed} were expected ({band})"),
    N_("replay {number} was ended by {cause}: {why}"),
    N_("a replay by hand was ended by {cause}: {why}"),
    N_("cmd/replay: refused: motion is not allowed here (allow_motion is false)"),
    N_("cmd/replay: refused: this monitor schedules no replays"),
    N_("cmd/replay: refused: a replay is under way"),
    N_("allow: no stop is waiting for a person"),
    N_("cmd: no alert can be {kind}: no replay has been assessed yet"),
    N_("no replay has been assessed yet"),
    N_("no active alert {alert}; active: {others}"),
    N_("cold start"),
    N_("evidence"),
    N_("learning"),
    N_("every"),
    N_("cron"),
)
# how windows, alerts and parts of the monitor are named in documents
NAMES = (
    N_("assessed"), N_("skipped"), N_("rejected"), N_("aborted"), N_("started"), N_("recorded"), N_("scheduled"), N_("manual"),
    N_("import"), N_("raised"), N_("updated"), N_("cleared"), N_("acknowledged"), N_("shelved"), N_("advisory"), N_("wear"), N_("limit"),
    N_("wear_rising"), N_("sudden_step"), N_("friction_falling"), N_("common_mode"), N_("gain_contradiction"),
    N_("mounting_contradiction"), N_("payload_contradiction"), N_("temperature_sensor"), N_("data_quality"), N_("outside_range"),
    N_("store_restored"), N_("nothing_learnt"), N_("stopped"), N_("stale"), N_("unheard"), N_("wear tier"), N_("ground"), N_("wall"),
    N_("ceiling"), N_("store"), N_("disk"), N_("clock"), N_("backup"), N_("router"), N_("Base"), N_("Shoulder"), N_("Elbow"),
    N_("Wrist 1"), N_("Wrist 2"), N_("Wrist 3"), N_("The arm"), N_("Joint {number}"), N_("joint {number}"), N_("scheduler"), N_("bus"),
    N_("listener"), N_("maintenance"),
)  # fmt: skip
# what the report says of its method; `service.history.report` puts it into the document
LIMITS = (
    N_("Friction does not see everything: a flexspline or a bearing can break with little change of friction before it."),
    N_("Wear that begins together with a change of tool, payload, mounting or trajectory never seen before is taken for the change."),
    N_("Remaining life is the time until friction meets its configured limit, not until a joint fails."),
    N_("All joints rising together is taken for what they share (temperature, supply, payload), not for wear of each."),
)
