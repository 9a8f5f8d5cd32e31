"""The time loop in C. It calls the functions that FFCx generates from the weak form.

The C files are in `c`. The Python files compile them, convert the scene and run blocks of steps.
"""
