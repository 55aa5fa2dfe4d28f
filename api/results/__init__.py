"""What is made of datasets: fits, reports, verdicts, and the certificates and files of others that they need."""
