"""From a netlist to circuit models: what ngspice is asked, and what is made of the answers."""
