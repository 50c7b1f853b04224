"""The operator panel: a local web page that starts the commands of sawbench and shows what they say."""
