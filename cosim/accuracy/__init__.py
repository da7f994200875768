"""What accuracy costs in time: errors of results over settings of the solver, against references."""
