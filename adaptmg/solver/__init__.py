"""The methods a user names, one a file, and solve(), Result and Status around them."""
