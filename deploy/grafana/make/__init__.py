"""The dashboards as code: ``python -m deploy.grafana.make`` writes ``deploy/grafana/dashboards``."""
