"""Independent solvers that tests compare the program with; nothing here is shipped or shares its code."""
