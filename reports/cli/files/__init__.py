"""Files that ``ocp solve`` reads: guesses, and .nl files of AMPL, Pyomo and JuMP."""
