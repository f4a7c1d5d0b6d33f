"""joint-monitor: friction health of a robot arm, published over Zenoh.

One replay goes through the rooms in this order. Each arrow carries a frozen value:

    acquire → Recording → identify → Identification → judge → Assessment → store, publish → views

This is the map of the house, and its only copy. A room imports only from rooms below it. Rooms marked ∘ are pure: they do no I/O,
read no clock and start no thread; one module, `model.robot`, reads the robots that are packaged with it. `make lint` checks both, and a
test holds this map against the linter's contracts.

    __main__        python -m monitor
    cli             the commands: a module a topic, one module of shared options
    api             the same for Python programs and notebooks: one module
    studies         the whole: simulated arms (demo, rehearsal, performance card, the paper's campaign), and the past of real ones once more
    gateway         the plant's alerts, told to people and to other systems: mail, webhooks, work orders
    plant           many arms: their histories copied into one database, their health followed, the worst first
    service         the daemon: replay cycle, bus handlers, scheduler, maintenance, systemd
    config          one TOML file → the settings of every room; reload
    views           what a person looks at: web page, printed report, plots, terminal
    acquire         robot → Recording, in child processes that may die; conditions, guard and gate before any motion
    simulate        a UR controller made of software, on the real wire; it does not know the monitor's model
    store           one robot's history on disk: SQLite, recordings and their archive, backups, provenance
    publish         Assessment → Zenoh and metrics; the documents and the typed client
    judge         ∘ Identification → Assessment: temperature, drift, torque, alerts; `judge.assess` is the whole flow from a Recording
    design        ∘ robot, mounting and cell → a trajectory with its proof
    identify      ∘ Recording → Identification: parameters, friction, uncertainty, warnings
    model         ∘ the arm as mathematics: robot, trajectory, regressor, base parameters, friction laws, energy
    recording     ∘ the value that acquire makes and identify reads
    errors        ∘ every error of this package, with its exit code
    reason        ∘ what is said to people, as a value: a code with parameters; its sentence is made at the edge

One alphabet of shapes holds everywhere: N samples, J joints (numbered from 1 where people read them), P = 13·J standard parameters,
B base parameters. Units are part of the names: `_nm`, `_rad_s`, `_c`, `_unix_s`. Frames follow the standard Denavit–Hartenberg convention.
"""

__version__ = "1.0.0"
