"""The command `init`: the questions and answers from which a first configuration is written."""
