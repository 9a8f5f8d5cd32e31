"""Periodic motions: one of them (`periodic`), and families (`backbone`, `forced_response`)."""
