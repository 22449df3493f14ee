"""Contacts of many bodies: which links may meet in a step, when the first of them do, and what their impacts do."""
