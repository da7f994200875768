"""Pictures of studies: one module a study, each with a function `draw`."""
