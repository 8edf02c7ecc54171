"""What estimates are made of: stresses, who lies beside whom, tractions on boundaries. Arrays in, arrays out."""
