"""ngspice as a service: flat decks, safety, the shared library, the child process."""
