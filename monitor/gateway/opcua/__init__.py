"""OPC UA: a read-only server in which an arm is a motion device of OPC 40010-1, with the condition of each joint."""
