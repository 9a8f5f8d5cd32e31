"""The time loop in C, on the functions that FFCx generates from the weak form.

C files lie in `c`; the Python here builds them, hands a scene over and runs blocks of steps.
"""
