"""Robot descriptions in and out, and regressor matrices: the only door to Pinocchio."""
