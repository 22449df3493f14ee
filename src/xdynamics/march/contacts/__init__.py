"""Contacts and friction: what touches, what that does to a march, and what the record says of it."""
