"""Worlds whose noise, weather and wear nobody told the judge: its false advisories and its delays where its assumptions do not hold.

Nothing in here reads a setting or an assumption of `monitor.judge`: `physics` has its own friction law and its own heat, `noise` what
differs from replay to replay, `change` what happens to healthy joints, `wear` what is to be detected. A `World` joins one of each under a
name, `table` lists them, `fleet` plays one over years as arrays, and `verdicts` counts what the judge made of it.

Shapes: D days, R replays of each arm (as many as days, where there is one a day), A arms, J joints.
"""
