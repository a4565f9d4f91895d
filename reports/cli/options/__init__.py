"""Options of the commands: each a class whose docstring is the command's help."""
