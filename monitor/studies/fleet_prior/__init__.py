"""A fleet's prior: what the joints of many arms say of a new arm of the same model, by partial pooling."""
