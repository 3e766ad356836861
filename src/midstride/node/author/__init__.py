"""What the author of a node declares and uses: components, ports, functionalities and their modes."""
