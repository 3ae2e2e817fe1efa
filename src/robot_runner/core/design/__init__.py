"""Design of experiments: factors, combinations, exclusions, repetitions, order. Pure: nothing reads or writes."""
