"""The model as its user describes it, as plain data: beams, sections, joints, supports and loads.

Every value is checked when it is given. Nothing is assembled or solved.
"""
