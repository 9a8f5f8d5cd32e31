"""What the user describes: beams, sections, joints, supports and loads, as plain data.

Every value is checked here, when it is given. Nothing is assembled or solved.
"""
