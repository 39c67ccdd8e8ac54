"""What users pass in, checked: arguments, arrays, options, positions."""
