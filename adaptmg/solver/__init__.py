"""The methods a user names, and solve() around them; folders by what they hold."""
