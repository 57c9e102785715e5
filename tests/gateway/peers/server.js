// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
//
// node-opcua as server: server.js PORT FOLDER. Namespace urn:peer: y1 (good), y2 (uncertain), u1 (writable), array and
// setpoints (writable array). Open to everybody without encryption, and to user plc with password open-sesame with it.
const opcua = require("node-opcua");
const path = require("path");

async function main() {
    const [port, folder] = process.argv.slice(2);
    const server = new opcua.OPCUAServer({
        port: Number(port), hostname: "127.0.0.1", allowAnonymous: true,
        securityModes: [opcua.MessageSecurityMode.None, opcua.MessageSecurityMode.SignAndEncrypt],
        securityPolicies: [opcua.SecurityPolicy.None, opcua.SecurityPolicy.Basic256Sha256],
        userManager: { isValidUser: (name, password) => name === "plc" && password === "open-sesame" },
        serverCertificateManager: new opcua.OPCUACertificateManager({
            rootFolder: path.join(folder, "pki"), automaticallyAcceptUnknownCertificate: true,
        }),
    });
    await server.initialize();
    const space = server.engine.addressSpace;
    const mine = space.registerNamespace("urn:peer");
    const device = mine.addObject({ organizedBy: space.rootFolder.objects, browseName: "device" });
    const number = (name, value, statusCode) => {
        const node = mine.addVariable({
            componentOf: device, nodeId: `s=${name}`, browseName: name, dataType: "Double",
            minimumSamplingInterval: 10,
        });
        node.setValueFromSource({ dataType: "Double", value }, statusCode || opcua.StatusCodes.Good);
    };
    const array = (name, value) => {
        const node = mine.addVariable({
            componentOf: device, nodeId: `s=${name}`, browseName: name, dataType: "Double", valueRank: 1,
            arrayDimensions: [value.length], minimumSamplingInterval: 10,
        });
        node.setValueFromSource({ dataType: "Double", arrayType: opcua.VariantArrayType.Array, value });
    };
    number("y1", 3.25);
    number("y2", -1e-3, opcua.StatusCodes.UncertainLastUsableValue);
    number("u1", 0);
    array("array", [1.5, 2.5, 3.5]);
    array("setpoints", [0, 0]);
    await server.start();
    console.log("ready");
}
main();
