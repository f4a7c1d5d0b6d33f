"""The past of an arm, a site or a plant judged once more, on many processes: what would have been said otherwise."""
