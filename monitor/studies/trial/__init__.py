"""The trial: a real daemon and a simulated arm whose clocks run together, many times as fast as the host's."""
