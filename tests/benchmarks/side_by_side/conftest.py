"""These scripts run in folders and interpreters of their own, see _figaroh.py."""

collect_ignore_glob = ["*_user*.py"]
