"""The arm's ordinary work in the daemon: rows become sums, and the sums of a day are judged."""
