"""From runs to evidence: states between steps, two runs side by side, modes and stable steps."""
