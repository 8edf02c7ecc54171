"""What of a store lies beside its one class: tables, files of runs, rescue."""
