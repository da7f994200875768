"""The circuit models of many boards that differ in the values of their components."""
