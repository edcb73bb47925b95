// An identity provider on loopback, with the sign-in page that it brings for development:
//   node oidc_provider.mjs PORT WAY_BACK MODULES
// Whoever signs in has the groups that stand behind a dash: `ada-operators-chemists`.
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [port, wayBack, modules] = process.argv.slice(2);
const require = createRequire(`${modules}/`);
const { default: Provider } = await import(pathToFileURL(require.resolve("oidc-provider")));

// Where the command line of the lab waits, at any port: RFC 8252, 7.3.
const commandLine = `http://127.0.0.1/login/${new URL(wayBack).host.replace(":", "-")}`;

const provider = new Provider(`http://127.0.0.1:${port}`, {
  clients: [{
    client_id: "labos",
    token_endpoint_auth_method: "none",
    redirect_uris: [wayBack],
    grant_types: ["authorization_code"],
    response_types: ["code"],
    application_type: "native",
  }, {
    client_id: "labos-login",
    token_endpoint_auth_method: "none",
    redirect_uris: [commandLine],
    grant_types: ["authorization_code", "urn:ietf:params:oauth:grant-type:device_code"],
    response_types: ["code"],
    application_type: "native",
  }],
  features: { deviceFlow: { enabled: true } },
  pkce: { required: () => true },
  claims: { openid: ["sub"], profile: ["name", "groups"] },
  findAccount: async (_, id) => ({
    accountId: id,
    claims: async () => ({ sub: id, name: `Person ${id}`, groups: id.split("-").slice(1) }),
  }),
});
provider.listen(Number(port), "127.0.0.1", () => console.log("ready"));
