"""LabOS: a lab operating system for self-driving laboratories."""
