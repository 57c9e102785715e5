// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
//
// node-opcua as server: server.js PORT FOLDER. Namespace urn:peer: y1 (good), y2 (uncertain), u1 (writable), array.
const opcua = require("node-opcua");
const path = require("path");

async function main() {
    const [port, folder] = process.argv.slice(2);
    const server = new opcua.OPCUAServer({
        port: Number(port), hostname: "127.0.0.1", allowAnonymous: true,
        securityModes: [opcua.MessageSecurityMode.None], securityPolicies: [opcua.SecurityPolicy.None],
        serverCertificateManager: new opcua.OPCUACertificateManager({ rootFolder: path.join(folder, "pki") }),
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
        return node;
    };
    number("y1", 3.25);
    number("y2", -1e-3, opcua.StatusCodes.UncertainLastUsableValue);
    number("u1", 0);
    const array = mine.addVariable({ componentOf: device, nodeId: "s=array", browseName: "array", dataType: "Double",
        valueRank: 1, arrayDimensions: [3], minimumSamplingInterval: 10 });
    array.setValueFromSource({ dataType: "Double", arrayType: opcua.VariantArrayType.Array, value: [1.5, 2.5, 3.5] });
    await server.start();
    console.log("ready");
}
main();
