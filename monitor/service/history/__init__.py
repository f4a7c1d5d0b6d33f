"""What is made of a history: assessments stored, recomputed, reported, exported and imported, and an arm's status. I/O.

A recording survives a crash between its writing and its assessment. It is written to disk before the ledger says `recorded`. After a crash
`Ledger.repair` sets the window to `recorded` where the file exists, and to `aborted` where it does not. `Monitor.recover` then assesses
every waiting recording, in the order of time, by `assess_stored`, which stores assessment and state in one transaction. Where a backup
replaced the history, `adopt_orphans` enters the recordings that the ledger does not hold, so that they wait in the same way.
"""
