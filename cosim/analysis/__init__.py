"""Theory of a held contact: linearisation, exact stability, passivity, noise. A library."""
